"""Oracles: normals by definition in float64 through the reference rasterizer, and a known wall."""

import numpy as np
import torch

import gscore
from gscore.bench.synthetic import synthetic_scene
from gscore.raster.api import splat_normals
from gscore.raster.reference import quat_to_rotmat, rasterize_reference
from gscore.sh import rgb_to_sh0
from gscore.splats import PARAMETERS, Splats


def _by_definition(splats: Splats, K: np.ndarray, viewmat: np.ndarray, size: tuple[int, int]):
    """[H, W, 3] sum of weight times normal, and [H, W] alpha, float64."""
    tensors = {n: torch.from_numpy(getattr(splats, n)).double() for n in PARAMETERS}
    axes = quat_to_rotmat(tensors["quats"] / tensors["quats"].norm(dim=1, keepdim=True))
    shortest = tensors["scales"].argmin(dim=1)
    view = torch.from_numpy(viewmat)
    normals = axes[torch.arange(len(axes)), :, shortest] @ view[:3, :3].T
    places = tensors["means"] @ view[:3, :3].T + view[:3, 3]
    normals = normals * -torch.sign((normals * places).sum(1, keepdim=True))
    tensors["sh0"] = torch.from_numpy(rgb_to_sh0(((normals + 1) / 2).numpy()))[:, None]
    tensors["shN"] = torch.zeros(len(axes), 0, 3, dtype=torch.float64)
    out = rasterize_reference(**tensors, viewmat=view, K=torch.from_numpy(K), width=size[0],
                              height=size[1], raw=True)  # fmt: skip
    return (2 * out.rgb - out.alpha[..., None]).numpy(), out.alpha.numpy()


def test_normals_of_a_picture() -> None:
    """Oracle: the reference; directions where the sum is short amplify rounding by its inverse."""
    splats, cameras = synthetic_scene(800, 96, 64)
    K, viewmat = cameras.Ks[0], cameras.viewmats[0]
    sums, alpha = _by_definition(splats, K, viewmat, (96, 64))
    found = gscore.render(splats, K, viewmat, 96, 64, normals=True).normal
    lengths = np.linalg.norm(sums, axis=-1)
    good = lengths > 0.02
    assert found is not None
    assert good.mean() > 0.3
    error = np.abs(found - sums / np.maximum(lengths, 1e-12)[..., None])
    assert (error * lengths[..., None])[good].max() < 1e-4
    assert (found[alpha == 0] == 0).all()
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1)[good], 1, atol=1e-5)


def test_normal_of_a_tilted_wall() -> None:
    """Oracle: the wall's own normal, from both of its sides; without `normals` there is none."""
    quat = np.array([0.9, 0.3, -0.2, 0.1], np.float32)
    axis = quat_to_rotmat(torch.from_numpy(quat / np.linalg.norm(quat))[None])[0, :, 2].numpy()
    along = np.indices((21, 21)).reshape(2, -1).T / 10.0 - 1
    frame = quat_to_rotmat(torch.from_numpy(quat / np.linalg.norm(quat))[None])[0].numpy()
    count = len(along)
    wall = Splats(
        means=(along @ frame[:, :2].T + [0, 0, 3]).astype(np.float32),
        quats=np.tile(quat, (count, 1)),
        scales=np.tile(np.log(np.array([0.1, 0.1, 0.001], np.float32)), (count, 1)),
        opacities=np.full(count, 4, np.float32),
        sh0=np.zeros((count, 1, 3), np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )
    K = np.array([[60.0, 0, 20], [0, 60, 20], [0, 0, 1]])
    back = np.diag([-1.0, 1.0, -1.0, 1.0])
    back[:3, 3] = [0, 0, 6]
    for viewmat in (np.eye(4), back):
        view = gscore.render(wall, K, viewmat, 40, 40, normals=True)
        expected = viewmat[:3, :3] @ axis
        expected *= -np.sign(expected @ [0, 0, 1])
        np.testing.assert_allclose(view.normal[20, 20], expected, atol=1e-4)
        towards = splat_normals(wall.means, wall.quats, wall.scales, viewmat)
        np.testing.assert_allclose(towards, np.tile(expected, (count, 1)), atol=1e-5)
    assert gscore.render(wall, K, np.eye(4), 40, 40).normal is None


def test_parallel_rays_and_windows() -> None:
    """Oracle: the direction +z decides the side; a window is a part of the picture."""
    splats, cameras = synthetic_scene(500, 96, 64)
    K, viewmat = cameras.Ks[0], cameras.viewmats[0]
    normals = splat_normals(splats.means, splats.quats, splats.scales, viewmat, orthographic=True)
    assert (normals[:, 2] <= 0).all()
    how = {"normals": True, "depths": False}
    whole = gscore.render(splats, K, viewmat, 96, 64, **how).normal
    part = gscore.render(splats, K, viewmat, 96, 64, window=(17, 5, 40, 30), **how).normal
    np.testing.assert_array_equal(part, whole[5:35, 17:57])

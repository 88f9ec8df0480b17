"""Oracles: normals by definition in float64 through the reference rasterizer, and a known wall."""

import numpy as np
import torch

import gscore
from gscore.bench.synthetic import synthetic_scene
from gscore.raster.api import splat_normals
from gscore.raster.normals import oriented_normals, rasterize_normals
from gscore.raster.reference import quat_to_rotmat, rasterize_reference
from gscore.shared_constants import SH_C0
from gscore.splats import PARAMETERS, Splats


def _tensors(splats: Splats) -> dict[str, torch.Tensor]:
    return {n: torch.from_numpy(getattr(splats, n)).double() for n in PARAMETERS}


def _by_definition(
    tensors: dict[str, torch.Tensor], K: np.ndarray, viewmat: np.ndarray, size: tuple[int, int]
) -> tuple[torch.Tensor, torch.Tensor]:
    """[H, W, 3] sum of weight times normal, and [H, W] alpha, float64; differentiable."""
    axes = quat_to_rotmat(tensors["quats"] / tensors["quats"].norm(dim=1, keepdim=True))
    shortest = tensors["scales"].argmin(dim=1)
    view = torch.from_numpy(viewmat)
    normals = axes[torch.arange(len(axes)), :, shortest] @ view[:3, :3].T
    places = tensors["means"] @ view[:3, :3].T + view[:3, 3]
    normals = normals * -torch.sign((normals * places).sum(1, keepdim=True))
    sh0 = normals[:, None] / (2 * SH_C0)  # colours of (normal + 1) / 2
    tensors = tensors | {"sh0": sh0, "shN": sh0.new_zeros(len(sh0), 0, 3)}
    size = {"width": size[0], "height": size[1]}
    out = rasterize_reference(**tensors, viewmat=view, K=torch.from_numpy(K), raw=True, **size)
    return 2 * out.rgb - out.alpha[..., None], out.alpha


def test_normals_of_a_picture() -> None:
    """Oracle: the reference; directions where the sum is short amplify rounding by its inverse."""
    splats, cameras = synthetic_scene(800, 96, 64)
    K, viewmat = cameras.Ks[0], cameras.viewmats[0]
    sums, alpha = (p.numpy() for p in _by_definition(_tensors(splats), K, viewmat, (96, 64)))
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


def _loss(sums: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Sum of both pictures times fixed random weights."""
    rng = torch.Generator().manual_seed(7)
    weights = torch.randn(*sums.shape[:2], 4, generator=rng, dtype=torch.float64).to(sums.dtype)
    return (sums * weights[..., :3]).sum() + (alpha * weights[..., 3]).sum()


def test_gradients_of_normals() -> None:
    """Oracles: central differences of the reference in float64; and the reference's gradients for
    the library's, in float32."""
    splats, cameras = synthetic_scene(40, 48, 32)
    K, viewmat = cameras.Ks[0], cameras.viewmats[0]
    exact = {n: t.requires_grad_() for n, t in _tensors(splats).items()}
    names = ("means", "quats", "scales", "opacities")
    inputs = [exact[name] for name in names]
    loss = _loss(*_by_definition(exact, K, viewmat, (48, 32)))
    expected = torch.autograd.grad(loss, inputs)
    rng = np.random.default_rng(1)
    with torch.no_grad():
        for name, gradient in zip(names, expected, strict=True):
            direction = torch.from_numpy(rng.normal(size=gradient.shape))
            step, values = 1e-7, []
            for sign in (1, -1):
                moved = exact | {name: exact[name] + sign * step * direction}
                values.append(_loss(*_by_definition(moved, K, viewmat, (48, 32))))
            slope = (values[0] - values[1]) / (2 * step)
            assert abs(slope - (gradient * direction).sum()) < 1e-4 * abs(slope), name
    single = {n: t.detach().float().requires_grad_() for n, t in exact.items() if n in names}
    drawn = rasterize_normals(
        *single.values(), torch.from_numpy(viewmat).float(), torch.from_numpy(K).float(), 48, 32,
        raw=True, threads=1,
    )  # fmt: skip
    found = torch.autograd.grad(_loss(*drawn[:2]), [single[name] for name in names])
    for name, mine, true in zip(names, found, expected, strict=True):
        assert (mine - true).norm() < 2e-3 * true.norm(), name


def test_both_definitions_agree() -> None:
    """Oracle: the numpy function for the torch one; quaternions of any length."""
    splats, cameras = synthetic_scene(300, 48, 32)
    viewmat = cameras.viewmats[0]
    tensors = _tensors(splats)
    found = oriented_normals(
        tensors["means"], 3 * tensors["quats"], tensors["scales"], torch.from_numpy(viewmat)
    )
    expected = splat_normals(splats.means, splats.quats, splats.scales, viewmat)
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-12)

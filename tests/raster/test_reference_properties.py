"""Oracles: exact invariances, damage that must stay local, boundary bands made by hand."""

from dataclasses import replace

import pytest
import torch

from gscore.errors import ShapeError
from gscore.raster.reference import boundary_band, rasterize_reference
from gscore.stress.truth import request_of
from tests.raster.damage import assert_row_without_gradient

OPTIONS = {"raw": True, "inverse_depth": True, "depth": True}
PARAMETERS = ("means", "quats", "scales", "opacities", "sh0", "shN")


def pictures(out):
    return torch.cat([out.rgb.flatten(), *(p.flatten() for p in out[1:])])


def test_splat_order_does_not_matter(random_scene):
    scene = random_scene(1, count=40)
    order = torch.randperm(40, generator=torch.Generator().manual_seed(0))
    base, shuffled = scene.inputs(), scene.rows(order).inputs()
    first = rasterize_reference(**base, **OPTIONS)
    second = rasterize_reference(**shuffled, **OPTIONS)
    assert first.alpha.mean() > 0.1
    assert torch.equal(pictures(first), pictures(second))
    first.rgb.square().sum().backward()
    second.rgb.square().sum().backward()
    for name in PARAMETERS:
        assert torch.equal(base[name].grad[order], shuffled[name].grad)


def test_moving_world_and_camera_together_changes_nothing(random_scene):
    """Degree 0: higher harmonics would have to turn too."""
    scene = random_scene(2, count=30, sh_degree=0)
    other = random_scene(3, count=1).viewmat  # any rigid motion
    rotation, shift = other[:3, :3], other[:3, 3]
    w, x, y, z = rotation_to_quat(rotation)
    q = scene.quats
    turned = torch.stack(
        [
            w * q[:, 0] - x * q[:, 1] - y * q[:, 2] - z * q[:, 3],
            w * q[:, 1] + x * q[:, 0] + y * q[:, 3] - z * q[:, 2],
            w * q[:, 2] - x * q[:, 3] + y * q[:, 0] + z * q[:, 1],
            w * q[:, 3] + x * q[:, 2] - y * q[:, 1] + z * q[:, 0],
        ],
        1,
    )
    moved = replace(
        scene,
        means=scene.means @ rotation.T + shift,
        quats=turned,
        viewmat=scene.viewmat @ torch.linalg.inv(other),
    )
    first = rasterize_reference(**scene.inputs(), **OPTIONS)
    second = rasterize_reference(**moved.inputs(), **OPTIONS)
    assert first.alpha.mean() > 0.1
    # 1e-6, because the matrices have float32 values and are orthogonal only to that
    assert (pictures(first) - pictures(second)).abs().max() < 1e-5


def rotation_to_quat(matrix):
    """wxyz from the trace; the test's rotations are far from half a turn."""
    w = torch.sqrt(1 + matrix.trace()) / 2
    assert w > 0.1
    x = (matrix[2, 1] - matrix[1, 2]) / (4 * w)
    y = (matrix[0, 2] - matrix[2, 0]) / (4 * w)
    z = (matrix[1, 0] - matrix[0, 1]) / (4 * w)
    return w, x, y, z


def test_quaternion_length_and_sign_do_not_matter(random_scene):
    scene = random_scene(4, count=20)
    base = rasterize_reference(**scene.inputs(), **OPTIONS)
    scaled = replace(scene, quats=scene.quats * torch.logspace(-6, 6, 20).double()[:, None])
    negated = replace(scene, quats=-scene.quats)
    assert base.alpha.mean() > 0.1
    assert torch.equal(pictures(base), pictures(rasterize_reference(**negated.inputs(), **OPTIONS)))
    difference = pictures(base) - pictures(rasterize_reference(**scaled.inputs(), **OPTIONS))
    assert difference.abs().max() < 1e-12


def test_chunks_change_nothing(random_scene):
    scene = random_scene(5, count=25)
    results = []
    for pairs_per_chunk in (1, 1000, 1 << 20):
        inputs = scene.inputs()
        out = rasterize_reference(**inputs, **OPTIONS, pairs_per_chunk=pairs_per_chunk)
        out.rgb.square().sum().backward()
        results.append((pictures(out).detach(), inputs["means"].grad))
    assert results[0][1].abs().max() > 0.01
    for values, gradient in results[1:]:
        assert (values - results[0][0]).abs().max() < 1e-14
        assert (gradient - results[0][1]).abs().max() < 1e-11


def test_float32_agrees_with_float64_outside_the_band_and_flips_stay_inside(random_scene):
    scene = random_scene(6, count=400, width=48, height=40, overscan=0.2)
    inputs = scene.inputs()
    exact = rasterize_reference(**inputs, raw=True)
    rounded = rasterize_reference(**inputs, raw=True, dtype=torch.float32)
    assert rounded.rgb.dtype == torch.float32
    assert exact.alpha.mean() > 0.1
    band = boundary_band(*request_of(inputs))
    assert 0 < band.double().mean() < 0.2
    error = (rounded.rgb.double() - exact.rgb).abs().amax(2)
    assert error[~band].max() < 1e-5


def test_damaged_rows_vanish_and_touch_nothing_else(random_scene, hostile_rows):
    """Pictures and gradients equal, bit for bit, those of the scene without the row."""
    scene = random_scene(7, count=12)
    row = 5
    others = torch.arange(12) != row
    inputs = scene.rows(others).inputs()
    expected = rasterize_reference(**inputs, **OPTIONS)
    assert expected.alpha.mean() > 0.1
    expected.rgb.square().sum().backward()
    for name, damage in hostile_rows.items():
        damaged = scene.with_row(row, **damage).inputs()
        out = rasterize_reference(**damaged, **OPTIONS)
        assert torch.equal(pictures(out), pictures(expected)), name
        out.rgb.square().sum().backward()
        assert_row_without_gradient(damaged, inputs, row, name)


@pytest.mark.parametrize("count", [0, 3])
def test_empty_scenes_show_the_background(random_scene, count):
    """No splats at all, and splats that are all behind the camera."""
    scene = random_scene(8, count=3, depths=(-6.0, -1.0)).rows(torch.arange(count))
    inputs = scene.inputs()
    background = torch.tensor([0.25, 0.5, 0.75], dtype=torch.float64)
    out = rasterize_reference(**inputs, **OPTIONS, background=background)
    assert torch.equal(out.rgb, background.expand(20, 24, 3))
    for picture in out[1:]:
        assert not picture.any()
    assert not boundary_band(*request_of(inputs)).any()
    out.rgb.sum().backward()
    for name in (*PARAMETERS, "viewmat"):
        assert not inputs[name].grad.any(), name


def test_bad_input_is_refused(random_scene):
    inputs = random_scene(9, sh_degree=1).inputs()

    def refuses(message, **changes):
        changed = {**inputs, **changes}
        with pytest.raises(ShapeError, match=message):
            rasterize_reference(**changed)
        with pytest.raises(ShapeError, match=message):
            boundary_band(*request_of(changed))

    skewed = inputs["K"].clone()
    skewed[0, 1] = 0.1
    refuses("undistort", K=skewed)
    mirrored = inputs["K"].clone()
    mirrored[0, 0] *= -1
    refuses("positive fx", K=mirrored)
    refuses("0 to 1", sh_degree=2)
    refuses("quats must be", quats=inputs["quats"][:, :3])
    refuses("opacities must be", opacities=inputs["opacities"][:, None])
    refuses("0, 3, 8, 15 or 24", shN=inputs["shN"][:, :2])
    refuses("at least 1 x 1", width=0)


K_AXIS = torch.tensor([[20.0, 0, 8.5], [0, 20.0, 6.5], [0, 0, 1]], dtype=torch.float64)


def band_of(*splats, alpha_tolerance=1e-3, **options):
    """Band of splats from `one_splat` in a 16 x 12 image with the axis at pixel row 6, column 8."""
    merged = {name: torch.cat([splat[name] for splat in splats]) for name in splats[0]}
    viewmat = torch.eye(4, dtype=torch.float64)
    camera = {"viewmat": viewmat, "K": K_AXIS, "width": 16, "height": 12}
    asked = request_of({**merged, **camera}, **{"raw": False, **options})
    return boundary_band(*asked, alpha_tolerance=alpha_tolerance)


def test_band_marks_the_alpha_threshold(one_splat):
    """Opacity tuned so that the pixel three to the right lands on 1/255."""
    variance = (20 * 0.1 / 2) ** 2 + 0.3
    opacity = torch.tensor(9 / (2 * variance)).double().exp() / 255
    for factor, marked in [(1 + 5e-4, True), (1 - 5e-4, True), (1 + 2e-3, False)]:
        band = band_of(one_splat(sigma=0.1, opacity=float(opacity) * factor))
        assert bool(band[6, 11]) == marked
        assert not band[6, 8]
    assert band_of(one_splat(sigma=0.1, opacity=float(opacity) * 1.002), alpha_tolerance=5e-3)[
        6, 11
    ]


def test_band_marks_the_cap(one_splat):
    for opacity, marked in [(0.9895, True), (0.9905, True), (0.98, False)]:
        assert bool(band_of(one_splat(opacity=opacity))[6, 8]) == marked


def test_band_marks_the_stop_and_ignores_what_lies_behind_it(one_splat):
    def layers(last):
        opacities = [0.9, 0.9, 0.9, last]
        return [
            one_splat(sigma=0.3, opacity=o, position=(0, 0, 2 + i)) for i, o in enumerate(opacities)
        ]

    assert band_of(*layers(0.90005))[6, 8]  # 0.1^3 * 0.09995 is within 1e-3 of 1e-4
    assert not band_of(*layers(0.95))[6, 8]
    behind = one_splat(sigma=0.3, opacity=0.99, position=(0, 0, 9))  # on the cap, but hidden
    assert not band_of(*layers(0.95), behind)[6, 8]


def test_band_marks_depth_ties_among_drawn_splats_only(one_splat):
    def pair(gap, sigma=0.3):
        return (
            one_splat(sigma=sigma, opacity=0.5, position=(0, 0, 2)),
            one_splat(sigma=sigma, opacity=0.5, position=(0, 0, 2 + gap)),
        )

    assert band_of(*pair(1e-6))[6, 8]
    assert not band_of(*pair(1e-5))[6, 8]
    between = one_splat(sigma=0.02, opacity=0.5, position=(0.9, 0, 2 + 5e-7))
    assert band_of(*pair(1e-6), between)[6, 8]  # not drawn there: the tie stays
    assert not band_of(*pair(1e-6, sigma=0.01))[0, 0]  # tie, but drawn elsewhere


@pytest.mark.parametrize("z", [0.5 * (1 + 5e-7), 0.5 * (1 - 5e-7), 8 * (1 + 5e-7)])
def test_band_marks_splats_on_the_near_and_far_planes(one_splat, z):
    splat = one_splat(sigma=0.02 * z, opacity=0.5, position=(0, 0, z))
    assert band_of(splat, near=0.5, far=8.0)[6, 8]
    assert not band_of(splat, near=0.4, far=9.0)[6, 8]

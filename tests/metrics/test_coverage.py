"""Coverage of held-out views; oracle: a wall of splats and cameras placed by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from gscore.metrics import Evaluation
from gscore.metrics.coverage import coverage, state_coverage
from gscore.metrics.photo_renders import PhotoRenders
from gscore.scene import Cameras
from gscore.splats import Splats
from gscore.text_format import worst_view_text

SIZE, FOCAL, WALL = 96, 48.0, 5.0  # a field of view of 90 degrees


def plane(z: float, half: float, count: int = 60) -> Splats:
    """Opaque splats on a square at depth `z`."""
    side = np.linspace(-half, half, count)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side))
    n = len(x)
    return Splats(
        means=np.stack([x, y, np.full(n, z)], axis=1).astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        scales=np.full((n, 3), np.log(half / count), np.float32),
        opacities=np.full(n, 6.0, np.float32),
        sh0=np.zeros((n, 1, 3), np.float32),
        shN=np.zeros((n, 0, 3), np.float32),
    )


def both(one: Splats, other: Splats) -> Splats:
    """The splats of two models."""
    names = ("means", "quats", "scales", "opacities", "sh0", "shN")
    return Splats(**{k: np.concatenate([getattr(one, k), getattr(other, k)]) for k in names})


def cameras(*places: tuple[float, float, float]) -> Cameras:
    """Cameras at (x, z), turned about the vertical axis by degrees: to the right."""
    viewmats = np.tile(np.eye(4), (len(places), 1, 1))
    for viewmat, (x, z, degrees) in zip(viewmats, places, strict=True):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        viewmat[:3, :3] = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
        viewmat[:3, 3] = -viewmat[:3, :3] @ [x, 0, z]
    n = len(places)
    return Cameras(
        names=tuple(f"{i}.jpg" for i in range(n)),
        viewmats=viewmats,
        Ks=np.tile([[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1.0]], (n, 1, 1)),
        widths=np.full(n, SIZE),
        heights=np.full(n, SIZE),
    )


def share(
    splats: Splats,
    view: tuple[float, float, float],
    *photos: tuple[float, float, float],
    mask: np.ndarray | None = None,
) -> float:
    """Coverage of a view by photos."""
    dataset = SimpleNamespace(
        train=list(range(1, len(photos) + 1)),
        test=[0],
        mask_mode="none" if mask is None else "ignore",
        mask=lambda index: mask,
    )
    renders = PhotoRenders(splats, cameras(view, *photos), threads=1)
    return coverage(renders, dataset)["0.jpg"]


ROOM = plane(WALL, 30.0, 150)
ROW = ((-1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))


def test_a_view_between_photos_is_covered_and_one_past_them_is_not() -> None:
    """Oracle: geometry. Two photos see the wall from x = -5 to 5, a view at 0.5 up to 5.5."""
    assert share(ROOM, (0.0, 1.0, 0.0), *ROW) == 1.0
    assert share(ROOM, (0.5, 0.0, 0.0), *ROW) == pytest.approx(0.95, abs=0.03)
    found = share(ROOM, (0.0, 0.0, 40.0), *ROW)
    # The view spans -5 to 85 degrees, the second photo up to 45: tan of -45 to 5 of its own axis.
    expected = (np.tan(np.radians(5)) + 1) / 2
    assert found == pytest.approx(expected, abs=0.06)
    assert share(ROOM, (0.0, 0.0, 120.0), *ROW) == 0.0


def test_one_photo_does_not_cover() -> None:
    """Oracle: none with one photo; with a second, the part that both see."""
    assert share(ROOM, ROW[1], ROW[1]) == 0.0
    # x from -5 to 5 in the view; the photos see -10 to 0 and -9 to 1.
    assert share(ROOM, ROW[1], (-5, 0, 0), (-4, 0, 0)) == pytest.approx(0.5, abs=0.04)


def test_a_veil_before_the_view_does_not_excuse_it() -> None:
    """Oracle: the share without the veil, which no photo shows."""
    veil = plane(0.3, 0.4, 30)
    view = (0.0, 0.2, 0.0)
    photos = ((-1.5, 0.0, 0.0), (1.5, 0.0, 0.0), (0.0, -3.0, 0.0))
    assert share(both(ROOM, veil), view, *photos) >= 0.95
    assert share(ROOM, view, *photos) == 1.0


def test_the_back_of_a_wall_is_another_surface() -> None:
    """Oracle: a view from behind the wall that the photos show."""
    assert share(ROOM, (0.0, 2 * WALL, 180.0), *ROW) == 0.0


def test_sky_is_covered_where_photos_look_in_its_direction() -> None:
    """Oracle: a model without splats in view; directions alone count, from any place."""
    away = plane(-50.0, 0.1, 2)
    assert share(away, (0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (-9.0, 0.0, 0.0)) == 1.0
    assert share(away, (0.0, 0.0, 0.0), (9.0, 0.0, 90.0), (-9.0, 0.0, 90.0)) == 0.0


def test_masked_pixels_do_not_count() -> None:
    """Oracle: a view of which only the covered half is unmasked, and one without any pixel."""
    photos = (-5, 0, 0), (-4, 0, 0)
    mask = np.zeros((2 * SIZE, 2 * SIZE), np.uint8)
    assert share(ROOM, ROW[1], *photos, mask=mask) == 1.0
    mask[:, :SIZE] = 255
    assert share(ROOM, ROW[1], *photos, mask=mask) == 1.0
    assert share(ROOM, ROW[1], *photos, mask=mask[:, ::-1]) == pytest.approx(0.0, abs=0.1)


def test_the_worst_view_is_a_covered_one() -> None:
    """Oracle: by hand; without a metric there is no worst view."""
    rows = (("a", 20.0, 0.7, 1.0), ("b", 18.0, 0.8, 0.9), ("c", 9.0, 0.3, 0.89), ("d", None, 1, 1))
    views = [{"name": n, "psnr_cc": db, "ssim_cc": ssim} for n, db, ssim, _ in rows]
    found = Evaluation({}, views)
    state_coverage(found, {name: covered for name, *_, covered in rows})
    assert [view["coverage"] for view in found.views] == [1.0, 0.9, 0.89, 1]
    assert found.mean == {
        "worst_view": {
            "psnr_cc": {"view": "b", "value": 18.0},
            "ssim_cc": {"view": "a", "value": 0.7},
        },
        "not_covered": ["c"],
    }
    assert worst_view_text(found.mean) == (
        "Worst view, colour-corrected: PSNR 18.00 dB (b), SSIM 0.7000 (a). 1 view is not counted "
        "here, as training photos show less than 90 %: c."
    )
    nothing = Evaluation({}, [])
    state_coverage(nothing, {})
    assert nothing.mean["worst_view"] == {"psnr_cc": None, "ssim_cc": None}
    assert worst_view_text(nothing.mean) == "" == worst_view_text({})

"""Pictures of levels of detail. Oracle: pictures of the whole PLY."""

from pathlib import Path

import numpy as np
import pytest

from gscore.errors import FormatError
from gscore.io.lod_file import HEADER_BYTES
from gscore.io.ply.splats import read_ply
from gscore.lod.lod_renderer import LodModel, choose_chunks
from gscore.metrics.image import psnr
from gscore.raster.api import render
from gscore.raster.request import Frustum

from .conftest import COUNT, camera

SIZE = (96, 64)


def turned(viewmat: np.ndarray, degrees: float) -> np.ndarray:
    """The camera turned about its own y axis."""
    a = np.radians(degrees)
    turn = np.eye(4)
    turn[[0, 0, 2, 2], [0, 2, 0, 2]] = np.cos(a), np.sin(a), -np.sin(a), np.cos(a)
    return turn @ viewmat


@pytest.mark.parametrize("away", [-0.5, 0.3, 1.0, 3.0, 9.0, 60.0])
@pytest.mark.parametrize("degrees", [0, 50, 120])
def test_the_finest_everywhere_is_the_whole_model(
    ply: Path, lod: Path, away: float, degrees: float
) -> None:
    """Oracle: the render of the PLY, within 1/255, from near, among the splats and facing away;
    omitted chunks reach no pixel."""
    K, viewmat = camera(away)
    viewmat = turned(viewmat, degrees)
    whole = render(read_ply(ply), K, viewmat, *SIZE, near=0.02)
    with LodModel(lod) as model:
        made = model.render(K, viewmat, *SIZE, lod_px=0)
        assert model.chosen is not None and model.chosen.by_level(3)[1:] == [0, 0]
    assert np.abs(made.rgb - whole.rgb).max() <= 1 / 255
    assert np.abs(made.alpha - whole.alpha).max() <= 1 / 255
    assert made.visible == whole.visible


def test_chunks_outside_the_view_are_not_read(lod: Path) -> None:
    """Oracle: a camera close to the wall needs few of its 16 chunks; one that faces away, none but
    those around it."""
    K, viewmat = camera(0.5)
    with LodModel(lod) as model:
        model.render(K, viewmat, *SIZE, lod_px=0)
        assert model.chosen is not None and 0 < len(model.chosen.chunks) <= 6
        K, viewmat = camera(3.0)
        model.render(K, turned(viewmat, 180), *SIZE, lod_px=0)
        assert model.chosen.splats == 0


def test_far_cameras_take_coarse_levels(lod: Path) -> None:
    """Oracle: fewer splats the farther the camera; the finest level for near ones."""
    drawn = []
    with LodModel(lod) as model:
        for away in (0.5, 8, 30, 120, 2000):
            model.render(*camera(away), *SIZE, lod_px=0.5)
            assert model.chosen is not None
            drawn.append(model.chosen.by_level(3))
            assert model.chosen.pixels == 0.5
    assert drawn[0][1:] == [0, 0] and drawn[-1] == [0, 0, 1]
    coarseness = [np.dot(one, [0, 1, 2]) / sum(one) for one in drawn]
    assert coarseness == sorted(coarseness)


def test_every_place_is_drawn_once(lod: Path) -> None:
    """Oracle: the chunks of the finest level under the chosen ones; all are in sight."""
    with LodModel(lod) as model:
        for pixels in (0.1, 0.3, 1.0, 3.0):
            K, viewmat = camera(14.0)
            chosen = choose_chunks(model.index, Frustum(viewmat, K, *SIZE), pixels, eps2d=0.3)
            below = [
                4**level * chunk + k for level, chunk in chosen.chunks for k in range(4**level)
            ]
            assert sorted(below) == list(range(16))


def test_pictures_get_better_with_the_level(ply: Path, lod: Path) -> None:
    """Oracle: PSNR against the whole model as the allowed error falls."""
    K, viewmat = camera(14.0)
    whole = render(read_ply(ply), K, viewmat, *SIZE).rgb
    with LodModel(lod) as model:
        worth = [
            psnr(model.render(K, viewmat, *SIZE, lod_px=px).rgb, whole) for px in (9, 0.4, 0.1)
        ]
    assert 20 < worth[0] < worth[1] < worth[2]


def test_no_more_splats_than_asked_for(lod: Path) -> None:
    """Oracle: the number; the resulting error is reported; the coarsest chunk is always drawn."""
    K, viewmat = camera(9.0)
    with LodModel(lod) as model:
        for most in (COUNT, 2000, 400, 375, 1):
            model.render(K, viewmat, *SIZE, lod_px=0, most=most)
            assert model.chosen is not None
            assert model.chosen.splats <= max(most, int(model.index.levels[-1].counts[0]))
            assert (model.chosen.pixels > 0) == (most < COUNT)


def test_a_path_shows_what_single_pictures_show(lod: Path) -> None:
    """Oracle: each picture by a model without earlier pictures; chunks are loaded, kept and
    dropped."""
    with LodModel(lod) as walking:
        for away in (20, 3, 1, 0.4, 1, 6, 40, 2):
            K, viewmat = camera(away)
            made = walking.render(K, viewmat, *SIZE, lod_px=0.5)
            with LodModel(lod) as fresh:
                alone = fresh.render(K, viewmat, *SIZE, lod_px=0.5)
            assert np.abs(made.rgb - alone.rgb).max() <= 1 / 255
            assert made.visible == alone.visible


def test_chunks_that_stay_are_not_read_again(lod: Path, monkeypatch) -> None:
    """Oracle: the number of chunk reads from the file."""
    with LodModel(lod) as model:
        asked = []
        chunk = type(model.file).chunk
        monkeypatch.setattr(
            type(model.file), "chunk", lambda self, *at: asked.append(at) or chunk(self, *at)
        )
        K, viewmat = camera(3.0)
        model.render(K, viewmat, *SIZE, lod_px=0)
        assert model.chosen is not None
        assert sorted(asked) == sorted(model.chosen.chunks)
        model.render(K, turned(viewmat, 1), *SIZE, lod_px=0)
        assert len(asked) == len(set(asked))


def test_damaged_chunk_is_reported(lod: Path, tmp_path: Path) -> None:
    """Oracle: a sentence instead of a picture."""
    content = bytearray(lod.read_bytes())
    content[HEADER_BYTES + 4] ^= 1
    (tmp_path / "bad.lod").write_bytes(content)
    with (
        LodModel(tmp_path / "bad.lod") as model,
        pytest.raises(FormatError, match="chunk 0 of level 0 is damaged"),
    ):
        model.render(*camera(9.0), *SIZE, lod_px=0)

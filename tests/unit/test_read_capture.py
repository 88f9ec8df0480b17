"""Captures read without their photos, as in a program that only shows the cameras."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from gscore import DataConfig, DatasetError
from gscore.frontend import read_capture, read_colmap

STUDIO = Path(__file__).parent.parent.parent / "examples" / "studio"


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """The studio's model without photos."""
    shutil.copytree(STUDIO / "sparse", tmp_path / "capture" / "sparse")
    return tmp_path / "capture"


def test_colmap_without_photos(bare: Path) -> None:
    """Oracle: every image of the model, at the path of its photo."""
    model = read_colmap(STUDIO)
    capture = read_capture(DataConfig(source=bare), photos_required=False)
    assert [view.name for view in capture.views] == [image.name for image in model.images]
    for view, image in zip(capture.views, model.images, strict=True):
        assert view.image == bare / "images" / image.name
        np.testing.assert_array_equal(view.viewmat, image.viewmat)
    assert len(capture.points) == len(model.points)
    assert "60 of the 60 images" in capture.warnings[0]
    with pytest.raises(DatasetError, match="no image folder"):
        read_capture(DataConfig(source=bare))


def test_transforms_without_photos(tmp_path: Path) -> None:
    """Oracle: every frame of the file, at the path of its photo."""
    frame = {"file_path": "images/a.jpg", "transform_matrix": np.eye(4).tolist()}
    data = {"fl_x": 50.0, "w": 40, "h": 30, "frames": [frame]}
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    capture = read_capture(DataConfig(source=tmp_path), photos_required=False)
    assert [view.image for view in capture.views] == [tmp_path / "images" / "a.jpg"]
    assert "1 of the 1 images" in capture.warnings[0]
    with pytest.raises(DatasetError, match="1 of the 1 images"):
        read_capture(DataConfig(source=tmp_path))


def test_needs_no_pillow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: a Python in which importing Pillow and torch fails."""
    for name in ("PIL", "torch", "scipy", "pycolmap"):
        monkeypatch.setitem(sys.modules, name, None)
    assert len(read_capture(DataConfig(source=STUDIO)).views) == 60

"""Text files that an editor began with a byte order mark; oracle: the same files without it."""

import json
from pathlib import Path

import numpy as np
import pytest

from gscore.config import DataConfig, TrainConfig
from gscore.config_file import config_json, load_config
from gscore.datasets.pku.cams import read_cam
from gscore.datasets.split import split_views
from gscore.datasets.transforms_json import load_transforms
from gscore.depth.params import read_params
from gscore.io.cameras_json import read_cameras_json
from gscore.io.sequences import SequenceIndex, read_sequence, write_sequence

MARKS = pytest.mark.parametrize("mark", ["", "\ufeff"])


@MARKS
def test_lists_and_camera_texts(mark: str, tmp_path: Path) -> None:
    """Oracle: the named view; the written numbers."""
    listed = tmp_path / "test.txt"
    listed.write_text(f"{mark}b.png\n", encoding="utf-8")
    config = DataConfig(source=tmp_path, eval=True, test_list=listed)
    assert split_views(["a.png", "b.png"], config) == ([0], [1])
    rows = "\n".join(" ".join(str(v) for v in row) for row in np.eye(4))
    text = f"{mark}extrinsic\n{rows}\n\nintrinsic\n60 0 32\n0 60 24\n0 0 1\n"
    (tmp_path / "0_cam.txt").write_text(text, encoding="utf-8")
    assert read_cam(tmp_path / "0_cam.txt")[0] == np.eye(4).tolist()


@MARKS
def test_json(mark: str, tmp_path: Path) -> None:
    """Oracle: the written values."""

    def write(name: str, content: str) -> Path:
        (tmp_path / name).write_text(mark + content, encoding="utf-8")
        return tmp_path / name

    assert load_transforms(write("transforms.json", '{"frames": []}')) == {"frames": []}
    entry = {"a": {"scale": 2.0, "offset": 0.5}}
    assert read_params(write("depth_params.json", json.dumps(entry)))["a"].scale == 2.0
    assert len(read_cameras_json(write("cameras.json", "[]"))) == 0
    config = config_json(DataConfig(source=tmp_path), TrainConfig(iterations=77))
    assert load_config(write("config.json", config))[1].iterations == 77
    write_sequence(tmp_path, SequenceIndex(options={}, frames=[], mean={"psnr": 1}), version="0")
    write("sequence.json", (tmp_path / "sequence.json").read_text())
    found = read_sequence(tmp_path)
    assert found is not None and found.mean == {"psnr": 1}

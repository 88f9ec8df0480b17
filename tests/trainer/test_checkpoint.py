"""Checkpoint files; oracle: the safetensors library, and what must be refused."""

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

from gscore.config import Background, TrainConfig
from gscore.errors import ConfigError, FormatError, GsError
from gscore.trainer import checkpoint
from gscore.trainer.trainer import Trainer

CONFIG = TrainConfig(iterations=20, max_splats=300, lpips=Path("a/b.onnx"), save_iterations=(3, 5))


@pytest.fixture
def saved(photos: Any, tmp_path: Path) -> tuple[Trainer, Path]:
    """A trainer after three steps, and its checkpoint."""
    trainer = Trainer(CONFIG, photos)
    for _ in range(3):
        trainer.step()
    path = tmp_path / "step.safetensors"
    checkpoint.save(path, trainer, {"anything": [1.5, None]})
    return trainer, path


def test_the_file_is_what_safetensors_reads(saved: tuple[Trainer, Path]) -> None:
    """Oracle: the library's own reader finds the same tensors, empty ones too."""
    trainer, path = saved
    found = load_file(path)
    expected = trainer.tensors()
    assert found.keys() == expected.keys()
    assert expected["param/shN"].numel() == 0
    for name, tensor in expected.items():
        assert torch.equal(found[name], tensor), name
        assert found[name].shape == tensor.shape, name


def test_everything_comes_back(saved: tuple[Trainer, Path], photos: Any) -> None:
    """Oracle: equality with what was saved."""
    trainer, path = saved
    found = checkpoint.load(path)
    assert found.config == CONFIG
    assert found.steps == 3
    assert found.trainer == trainer.state()
    assert found.session == {"anything": [1.5, None]}
    checkpoint.check_compatible(found, CONFIG, photos)


def test_another_config_is_refused_with_what_differs(
    saved: tuple[Trainer, Path], photos: Any
) -> None:
    """Oracle: the sentence names each option with both values, and no other."""
    found = checkpoint.load(saved[1])
    other = replace(CONFIG, max_splats=9, background=Background.WHITE, threads=7, iterations=50)
    with pytest.raises(ConfigError) as error:
        checkpoint.check_compatible(found, other, photos)
    message = str(error.value)
    assert "max_splats was 300, is 9; background was auto, is white." in message
    assert "threads" not in message
    assert "iterations" not in message


def test_another_capture_is_refused(
    saved: tuple[Trainer, Path], make_photos: Callable[..., Any]
) -> None:
    """Oracle: the sentence says what of the capture differs."""
    found = checkpoint.load(saved[1])
    with pytest.raises(ConfigError, match="training views of the capture are not the same"):
        checkpoint.check_compatible(found, CONFIG, make_photos(held_out=(3,)))
    photos = make_photos()
    photos.scene.cameras.viewmats[0, 0, 3] += 1e-9
    with pytest.raises(ConfigError, match="cameras of the capture are not the same"):
        checkpoint.check_compatible(found, CONFIG, photos)
    photos = make_photos()
    photos.images[2][0, 0, 0] ^= 1
    with pytest.raises(ConfigError, match="photos of the capture are not the same"):
        checkpoint.check_compatible(found, CONFIG, photos)
    photos = make_photos()
    photos.scene.points.colors[0, 0] ^= 1
    with pytest.raises(ConfigError, match="points of the capture are not the same"):
        checkpoint.check_compatible(found, CONFIG, photos)


def test_iterations_may_grow_but_not_end_before_the_checkpoint(
    saved: tuple[Trainer, Path], photos: Any
) -> None:
    """Oracle: 3 steps are done."""
    found = checkpoint.load(saved[1])
    checkpoint.check_compatible(found, replace(CONFIG, iterations=3), photos)
    checkpoint.check_compatible(found, replace(CONFIG, iterations=10_000), photos)
    with pytest.raises(ConfigError, match="at step 3, beyond iterations = 2"):
        checkpoint.check_compatible(found, replace(CONFIG, iterations=2), photos)


@pytest.mark.parametrize("keep", [0, 4, 8, 100, 2000, -1])
def test_a_truncated_file_is_refused(saved: tuple[Trainer, Path], keep: int) -> None:
    """Oracle: any prefix of the file is an error that names it."""
    path = saved[1]
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(FormatError, match=r"step\.safetensors is not a complete checkpoint"):
        checkpoint.load(path)


def test_other_safetensors_files_and_formats_are_refused(tmp_path: Path) -> None:
    """Oracle: a file without our metadata, and one of a format that does not exist yet."""
    path = tmp_path / "other.safetensors"
    for metadata in ({}, {"__metadata__": {"gscore": "{}"}}):
        header = json.dumps(metadata).encode()
        path.write_bytes(struct.pack("<Q", len(header)) + header)
        with pytest.raises(FormatError, match=r"other\.safetensors"):
            checkpoint.load(path)
    with pytest.raises(ConfigError, match="no such checkpoint"):
        checkpoint.load(tmp_path / "nothing")


def test_a_failed_write_leaves_the_old_file(
    saved: tuple[Trainer, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the bytes of the file before."""
    trainer, path = saved
    before = path.read_bytes()

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint, "_write", full)
    with pytest.raises(GsError, match="disk is full"):
        checkpoint.save(path, trainer, {})
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]

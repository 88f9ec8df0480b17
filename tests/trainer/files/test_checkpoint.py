"""Checkpoint files; oracle: the safetensors library, and files that must be refused."""

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors
import torch
from safetensors.torch import load_file, save_file

from gscore.config import Background, DataConfig, TrainConfig
from gscore.errors import ConfigError, FormatError, GsError
from gscore.events import Event, Warn
from gscore.raster import native_library
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.files import checkpoint
from gscore.trainer.files.run_folder import RunFolder
from gscore.trainer.run import train
from gscore.trainer.trainer import Trainer
from tests.checkpoint_files import checkpoint_json, with_checkpoint_json

pytestmark = pytest.mark.usefixtures("fake_engine")

CONFIG = TrainConfig(iterations=20, max_splats=300, lpips=Path("a/b.onnx"), save_iterations=(3, 5))


@pytest.fixture
def saved(photos: Any, tmp_path: Path) -> tuple[Trainer, Path]:
    """A trainer after three steps, and its checkpoint."""
    trainer = Trainer(CONFIG, Analysis(photos=photos))
    for _ in range(3):
        trainer.step()
    path = tmp_path / "step.safetensors"
    checkpoint.save(path, trainer, {"anything": [1.5, None]})
    return trainer, path


def test_the_file_is_what_safetensors_reads(saved: tuple[Trainer, Path]) -> None:
    """Oracle: the same tensors in the library's own reader, empty ones too."""
    trainer, path = saved
    found = load_file(path)
    expected = trainer.tensors()
    assert found.keys() == expected.keys()
    assert expected["param/shN"].numel() == 0
    for name, tensor in expected.items():
        assert torch.equal(found[name], tensor), name
        assert found[name].shape == tensor.shape, name


def test_everything_comes_back(saved: tuple[Trainer, Path], photos: Any) -> None:
    """Oracle: equality with the saved state."""
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
    """Oracle: the sentence, which names each changed option with both values, and no other."""
    found = checkpoint.load(saved[1])
    other = replace(CONFIG, max_splats=9, background=Background.WHITE, threads=7, iterations=50)
    with pytest.raises(ConfigError) as error:
        checkpoint.check_compatible(found, other, photos)
    message = str(error.value)
    assert "max_splats was 300, is 9; background was auto, is white." in message
    assert "threads was" not in message
    assert "iterations was" not in message


def test_another_capture_is_refused(
    saved: tuple[Trainer, Path], make_photos: Callable[..., Any]
) -> None:
    """Oracle: the sentence, which names the difference of the captures."""
    found = checkpoint.load(saved[1])
    with pytest.raises(ConfigError, match="training views of the capture are not the same"):
        checkpoint.check_compatible(found, CONFIG, make_photos(held_out=(3,)))
    photos = make_photos()
    photos.scene.cameras.viewmats[0, 0, 3] += 1e-9
    with pytest.raises(ConfigError, match="cameras of the capture are not the same"):
        checkpoint.check_compatible(found, CONFIG, photos)
    with pytest.raises(ConfigError, match=r"another run: -r was 1, is 2\. A resumed"):
        checkpoint.check_compatible(found, CONFIG, photos, changed=["-r was 1, is 2"])
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
    """Oracle: an error that names the file, for any prefix of it."""
    path = saved[1]
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(FormatError, match=r"step\.safetensors is not a complete checkpoint"):
        checkpoint.load(path)


def test_any_flipped_bit_is_noticed(saved: tuple[Trainer, Path]) -> None:
    """Oracle: the saved state; bits of the header and of all tensors flipped one at a time."""
    trainer, path = saved
    good = path.read_bytes()
    header = 8 + struct.unpack("<Q", good[:8])[0]
    rng = np.random.default_rng(1)
    places = [*rng.integers(0, header, 150).tolist(), *rng.integers(header, len(good), 150)]
    refused = 0
    for at in places:
        raw = bytearray(good)
        raw[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(raw)
        try:
            found = checkpoint.load(path)
        except FormatError as error:
            assert "step.safetensors" in str(error)
            refused += 1
        else:  # padding between the header and the tensors
            assert found.trainer == trainer.state()
            assert all(torch.equal(found.tensors[k], t) for k, t in trainer.tensors().items())
    assert refused > 290


def test_the_run_goes_on_from_the_checkpoint_before_a_damaged_one(
    capture: Path, tmp_path: Path
) -> None:
    """Oracle: the bytes of a run with undamaged checkpoints; the warning."""
    config = replace(CONFIG, iterations=30, lpips=None, checkpoint_iterations=(10, 20))
    data = DataConfig(source=capture)
    train(config, data, tmp_path)
    expected = (tmp_path / "point_cloud.ply").read_bytes()
    folder = RunFolder(tmp_path)
    for step in (20, 30):
        path = folder.checkpoint(step)
        raw = bytearray(path.read_bytes())
        raw[-5] ^= 8
        path.write_bytes(raw)
    (tmp_path / "point_cloud.ply").unlink()
    events: list[Event] = []
    train(config, data, tmp_path, events.append, resume=True)
    messages = [e.message for e in events if isinstance(e, Warn)]
    assert [("step_00000030" in m, "step_00000020" in m) for m in messages] == [
        (True, False),
        (False, True),
    ]
    assert all("continuing from step 10" in message for message in messages)
    assert (tmp_path / "point_cloud.ply").read_bytes() == expected
    assert len(list((tmp_path / "checkpoints").glob("*.damaged"))) == 2
    for path in folder.checkpoints():
        path.write_bytes(b"x" * 50)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    messages = (
        rf"All {len(folder.checkpoints())} checkpoints .* is not a complete .*with `--overwrite`"
    )
    with pytest.raises(FormatError, match=messages):
        train(config, data, tmp_path, resume=True)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_other_safetensors_files_and_formats_are_refused(tmp_path: Path) -> None:
    """Oracle: a file without our metadata, and one of a future format."""
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
    """Oracle: the bytes of the previous file."""
    trainer, path = saved
    before = path.read_bytes()

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint, "_write", full)
    with pytest.raises(GsError, match="disk is full"):
        checkpoint.save(path, trainer, {})
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("place", "value", "messages"),
    [
        (("trainer", "order"), [10**6] * 12, "order is .*expected views of the capture"),
        (("trainer", "position"), -(10**9), "position is -1000000000"),
        (("trainer", "steps"), "3", "steps is '3'"),
        (("trainer", "adam_steps", "means"), 1.5, "adam_steps of means is 1.5"),
        (("trainer", "frame", "extent"), 0, "extent and near must be positive"),
        (("trainer", "frame", "scale"), 10**400, "scale is inf"),
        (("session", "watchdog", "good"), [["a", "b"]], "good is 'a'"),
        (("session", "watchdog", "rescues"), -(10**9), "rescues is -1000000000"),
        (("session", "meter", "history"), [{"step": 1, "loss": []}], "loss of history is"),
        (("session", "evals"), [{"psnr": 1.0}], "a step of evals is None"),
        (("session", "warnings"), [3], "warnings is"),
        (("session", "steering"), {"found": [[1]], "length": 0}, "found is"),
    ],
)
def test_content_that_no_run_writes_is_refused(
    place: tuple[str, ...], value: Any, messages: str, capture: Path, tmp_path: Path
) -> None:
    """Oracle: a file with valid checksums; the sentence names the invalid entry."""
    config = replace(CONFIG, iterations=3, lpips=None)
    train(config, DataConfig(source=capture), tmp_path / "first")
    path = RunFolder(tmp_path / "first").checkpoints()[-1]
    raw = path.read_bytes()
    content = json.loads(checkpoint_json(raw))
    inner = content
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    path.write_bytes(with_checkpoint_json(raw, json.dumps(content).encode()))
    with pytest.raises(FormatError, match=f"can read .*{messages}"):
        train(
            replace(config, iterations=6),
            DataConfig(source=capture),
            tmp_path / "second",
            start_checkpoint=path,
        )


@pytest.mark.parametrize("stated", [True, None, [1]])
def test_a_checkpoint_says_which_tensors_it_has(saved: tuple[Trainer, Path], stated: Any) -> None:
    """Oracle: a file with intact metadata that state something else than a list of tensors."""
    path = saved[1]
    raw = path.read_bytes()
    content = json.loads(checkpoint_json(raw)) | {"tensors": stated}
    path.write_bytes(with_checkpoint_json(raw, json.dumps(content).encode()))
    with pytest.raises(FormatError, match="it has no list of its tensors"):
        checkpoint.load(path)


def test_a_header_of_many_tensors_is_parsed_a_bounded_number_of_times(
    saved: tuple[Trainer, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the number of openings, each of which parses the header; 2,000 extra tensors of one
    number each, without checksums, are reported as damage."""
    path = saved[1]
    save_file(
        {**load_file(path), **{f"extra/{i}": torch.zeros(1) for i in range(2000)}},
        path,
        _header(path.read_bytes())["__metadata__"],
    )
    opened: list[Any] = []
    opens = safetensors.safe_open
    counted = lambda *a, **k: opened.append(a) or opens(*a, **k)  # noqa: E731
    monkeypatch.setattr(safetensors, "safe_open", counted)
    with pytest.raises(FormatError, match=r"damaged: extra/0, extra/1, extra/10"):
        checkpoint.load(path)
    assert len(opened) <= 20


@pytest.mark.parametrize("crc", [None, "0", ""])
def test_a_checkpoint_without_its_checksum_is_refused(
    saved: tuple[Trainer, Path], crc: str | None
) -> None:
    """Oracle: a file without checksum; this format always has one, so the file was changed."""
    path = saved[1]
    metadata = _header(path.read_bytes())["__metadata__"]
    del metadata["crc32"]
    save_file(load_file(path), path, metadata if crc is None else metadata | {"crc32": crc})
    with pytest.raises(FormatError, match="its metadata is damaged"):
        checkpoint.load(path)


def _header(raw: bytes) -> dict[str, Any]:
    """The header of a safetensors file."""
    return json.loads(raw[8 : 8 + struct.unpack("<Q", raw[:8])[0]])


def test_tensors_that_do_not_fit_each_other_are_refused(
    saved: tuple[Trainer, Path], photos: Any
) -> None:
    """Oracle: each tensor in turn cut by a row, of another dtype, or missing."""
    trainer, path = saved
    found = checkpoint.load(path)
    for name, tensor in found.tensors.items():
        if name == "generator" or (name == "gathered/shN" and tensor.numel() == 0):
            continue
        other = torch.float64 if tensor.dtype == torch.float32 else torch.float32
        for odd in (tensor[:-1], tensor.to(other)):
            with pytest.raises(ValueError):
                trainer.restore(found.trainer, found.tensors | {name: odd})


def _goes_on(capture: Path, out: Path, *, steps: int) -> list[str]:
    """Continue the run in `out` to `steps`; return the warnings about its instruction set."""
    messages: list[Event] = []
    config = TrainConfig(iterations=steps, max_splats=200, checkpoint_iterations=(4, 8, 12))
    train(config, DataConfig(source=capture), out, messages.append, resume=out.exists())
    return [e.message for e in messages if isinstance(e, Warn) and e.code == "isa"]


@pytest.mark.usefixtures("real_engine")
@pytest.mark.skipif(
    len(native_library.available_isas()) < 2, reason="there is one instruction set only"
)
def test_resume_under_another_instruction_set_warns(capture: Path, tmp_path: Path) -> None:
    """Oracle: one warning, which names both sets and stays in the report; none for the same set, or
    for a checkpoint without a noted set."""
    first, other = native_library.available_isas()[0], native_library.available_isas()[-1]
    before, out = native_library.isa(), tmp_path / "run"
    try:
        native_library.set_isa(first)
        assert _goes_on(capture, out, steps=4) == []
        assert _goes_on(capture, out, steps=8) == []
        path = RunFolder(out).checkpoint(8)
        assert checkpoint.load(path).isa == first
        raw = path.read_bytes()
        native_library.set_isa(other)
        (message,) = _goes_on(capture, out, steps=12)
        assert f"used {first} up to step 8" in message and f"continues with {other}" in message
        assert f"GSCORE_ISA={first}" in message
        assert message in (out / "report.html").read_text(encoding="utf-8")
        assert _goes_on(capture, out, steps=13) == []

        content = json.loads(checkpoint_json(raw))
        del content["isa"]
        old = tmp_path / "old.safetensors"
        old.write_bytes(with_checkpoint_json(raw, json.dumps(content).encode()))
        assert checkpoint.load(old).isa is None
        messages: list[Event] = []
        config = TrainConfig(iterations=9, max_splats=200)
        data = DataConfig(source=capture)
        train(config, data, tmp_path / "new", messages.append, start_checkpoint=old)
        assert not [e for e in messages if isinstance(e, Warn) and e.code == "isa"]
    finally:
        native_library.set_isa(before)

"""Checkpoints: one safetensors file with all state of a run; read without running any code.

The tensors are those of `Trainer.tensors`; everything else is JSON in the file's metadata. CRC-32s
of both are checked when a checkpoint is read, because a flipped bit would go unnoticed.
"""

import hashlib
import json
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import torch

from ..._version import __version__
from ...config import TrainConfig
from ...config_file import differences, from_dict, to_dict
from ...errors import ConfigError, FormatError
from ...io.files import atomic_write, check_regular
from ...json_text import parse_json
from ...option_marks import mark_option
from ...options import options_of
from ...quoting import brief
from ..model.checkpoint_schema import as_int
from ..photos.view_sampler import Photos
from ..trainer import Trainer

FORMAT = 3
_DTYPES = {torch.float32: "F32", torch.float64: "F64", torch.uint8: "U8", torch.int64: "I64"}
FREE = frozenset(name for name, one in options_of(TrainConfig).items() if one.free)
"""Options that may change when a run is resumed."""
_OPENINGS = 16
"""Largest number of openings of a file while its tensors are read, minus one."""
_OFTEN_CHANGED = ("iterations", "time_budget", "target_psnr", "early_stop", "threads", "device")
"""The `FREE` options that messages name."""
_DEPTHS, _REGION, _GUIDE = "depths", "region", "guide"
"""Keys in a checkpoint's `capture`: depth maps, region with frozen splats, and guide meshes."""


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """Content of a checkpoint file."""

    path: Path
    config: TrainConfig
    """Options of the run that wrote it."""
    capture: dict[str, Any]
    """`fingerprint` of its capture."""
    trainer: dict[str, Any]
    """`Trainer.state`."""
    session: dict[str, Any]
    """State of the session: clock, history, evaluations."""
    tensors: dict[str, torch.Tensor]
    """`Trainer.tensors`."""
    isa: str | None = None
    """Instruction set of the run that wrote it; None: not recorded, as in older checkpoints."""
    warnings: tuple[str, ...] = ()
    """Sentences on removed options that the run had set."""

    @property
    def steps(self) -> int:
        """Steps taken."""
        return self.trainer["steps"]


def save(path: Path, trainer: Trainer, session: dict[str, Any]) -> None:
    """Write a checkpoint atomically.

    Raises:
        GsError: the disk is full or read-only.
    """
    content = {
        "format": FORMAT,
        "gscore": __version__,
        "torch": torch.__version__,
        "isa": trainer.engine.info.numerics,
        "config": to_dict(trainer.config),
        "capture": fingerprint(trainer.photos) | inputs_fingerprint(trainer),
        "trainer": trainer.state(),
        "session": session,
    }
    tensors = {key: tensor.contiguous() for key, tensor in trainer.tensors().items()}
    content["tensors"] = {key: _facts(tensor) for key, tensor in tensors.items()}
    text = json.dumps(content)
    metadata = {"gscore": text, "crc32": str(zlib.crc32(text.encode()))}
    atomic_write(path, lambda file: _write(file, tensors, metadata))


def load(path: Path) -> Checkpoint:
    """Read a checkpoint.

    Raises:
        FormatError: not a checkpoint, truncated, damaged, or of a later gscore.
        ConfigError: there is no such file.
    """
    from safetensors import SafetensorError, safe_open

    check_regular(path)
    if not path.is_file():
        raise ConfigError(f"{path}: there is no such checkpoint.")
    try:
        with safe_open(path, framework="pt") as file:
            metadata, keys = file.metadata() or {}, list(file.keys())
            text = metadata["gscore"]
        content = parse_json(text)
        if not isinstance(content, dict):
            raise ValueError("its metadata is not an object")
        tensors = {}
        if content.get("format") == FORMAT:
            tensors = _tensors(path, keys)
            _check_intact(text, metadata.get("crc32"), content, tensors)
    except (SafetensorError, KeyError, ValueError, OSError, RecursionError, MemoryError) as error:
        raise FormatError(
            f"{path} is not a complete checkpoint of gscore ({brief(error)}); use an older one."
        ) from error
    if content.get("format") != FORMAT:
        raise FormatError(
            f"{path} was written by gscore {brief(str(content.get('gscore')))} in format "
            f"{brief(str(content.get('format')))}; this gscore reads format {FORMAT}. "
            "Resume with that version, or start a new run."
        )
    warnings: list[str] = []
    with checkpoint_errors(path):
        as_int("steps", content["trainer"]["steps"])
        config = from_dict(TrainConfig, content["config"], where=str(path), warn=warnings.append)
        return Checkpoint(
            path=path,
            config=config,
            warnings=tuple(warnings),
            capture=dict(content["capture"]),
            trainer=dict(content["trainer"]),
            session=dict(content["session"]),
            tensors=tensors,
            isa=None if content.get("isa") is None else str(content["isa"]),
        )


@contextmanager
def checkpoint_errors(path: Path) -> Iterator[None]:
    """Context that turns errors from invalid checkpoint content into FormatError."""
    try:
        yield
    except (
        LookupError,
        TypeError,
        ValueError,
        ArithmeticError,
        AttributeError,
        RuntimeError,
    ) as error:
        raise FormatError(
            f"{path} is not a checkpoint that this gscore can read ({type(error).__name__}: "
            f"{brief(error)}); use an older one."
        ) from error


def check_compatible(
    checkpoint: Checkpoint, config: TrainConfig, photos: Photos, *, changed: Sequence[str] = ()
) -> None:
    """Raise ConfigError with the differences unless the run can be resumed with these inputs.

    `iterations` may change: schedules depend on the length of a run, so an extended run continues
    with the learning rates and refinements that a run of the new length has at this step.

    Args:
        checkpoint: Checkpoint to resume.
        config: Options of the resumed run.
        photos: Its capture.
        changed: Changed options of the capture, as sentences, which replace the resulting
            differences of the capture in the message.
    """
    different = differences(checkpoint.config, config, ignore=FREE)
    now = fingerprint(photos)
    mismatched = [
        k
        for k, was in checkpoint.capture.items()
        if k not in (_DEPTHS, _REGION, _GUIDE) and was != now.get(k)
    ]
    if mismatched:
        of = "" if config.region is None else f" that show the region {config.region}"
        different += changed or [f"{key} of the capture{of} are not the same" for key in mismatched]
    if different:
        free = ", ".join(mark_option(name) for name in _OFTEN_CHANGED)
        raise ConfigError(
            f"{checkpoint.path} belongs to another run: {'; '.join(different)}. A resumed run "
            f"takes its options from its config.json, so leave them out; {free} and output "
            "options may change. For anything else start a new run in another folder."
        )
    if checkpoint.steps > config.iterations and not config.time_budget:
        raise ConfigError(
            f"{checkpoint.path} is at step {checkpoint.steps}, beyond iterations = "
            f"{config.iterations}; increase `--iterations`."
        )


def isa_warning(checkpoint: Checkpoint, trainer: Trainer) -> str | None:
    """Return a warning if the run continues with another instruction set than before."""
    was, now = checkpoint.isa, trainer.engine.info.numerics
    if was is None or was == now:
        return None
    if was.startswith("gpu") or now.startswith("gpu"):
        return (
            f"The run used {was} up to step {checkpoint.steps} and continues with {now}: its "
            "splats will differ slightly from those of a run on a single device."
        )
    return (
        f"The run used {was} up to step {checkpoint.steps} and continues with {now}: its splats "
        "will differ slightly from those of a run with a single instruction set. If this machine "
        f"has {was}, set GSCORE_ISA={was}."
    )


def check_same_inputs(checkpoint: Checkpoint, trainer: Trainer) -> None:
    """Raise ConfigError unless `trainer` uses the depth maps, the region with its frozen splats,
    and the guide meshes of the checkpoint."""
    capture, now = checkpoint.capture, inputs_fingerprint(trainer)
    key = next((key for key in (_DEPTHS, _REGION, _GUIDE) if capture.get(key) != now.get(key)), "")
    if not key:
        return
    if key == _DEPTHS:
        how = "with other depth maps or another alignment of them"
        if key not in now:
            how = "with depth maps in the loss, this one has none"
        elif capture.get(key) is None:
            how = "without depth maps in the loss, this one has some"
        reason = f"it was trained {how}. Use the same `--depths` and depth options"
    elif key == _REGION:
        given = [path for path in (trainer.config.region, trainer.config.start_splats) if path]
        files = " and ".join(map(str, given)) or "its region"
        reason = f"its region or its frozen splats differ. Restore {files}"
    else:
        reason = "its guide meshes differ. Restore those of `--guide-surface` and `--guide-free`"
    raise ConfigError(
        f"{checkpoint.path} belongs to another run: {reason}, or start a new run in another folder."
    )


def inputs_fingerprint(trainer: Trainer) -> dict[str, str]:
    """Short hashes of the depth maps in the loss, the region with its frozen splats, and the guide
    meshes; without those that are not used."""
    found = {}
    if trainer.depth is not None:
        found[_DEPTHS] = trainer.depth.targets.content_hash()
    if trainer.region is not None:
        around = "" if trainer.models.frozen is None else trainer.models.frozen.content_hash()
        found[_REGION] = trainer.region.content_hash() + around
    return found | ({_GUIDE: trainer.guide_digest} if trainer.guide_digest else {})


def fingerprint(photos: Photos) -> dict[str, Any]:
    """Short hashes that identify a capture independently of its path, by subject."""
    cameras = photos.scene.cameras
    parts = {
        "names": "\n".join(cameras.names).encode(),
        "sizes": cameras.widths.tobytes() + cameras.heights.tobytes(),
        "cameras": cameras.viewmats.tobytes() + cameras.Ks.tobytes(),
        "training views": json.dumps([int(i) for i in photos.train]).encode(),
        "masks": photos.mask_mode.encode(),
        "photos": photos.content_hash().encode(),
    }
    hashes = {key: hashlib.sha256(value).hexdigest()[:16] for key, value in parts.items()}
    return hashes | {"points": photos.scene.points.content_hash()}


def _write(file: BinaryIO, tensors: dict[str, torch.Tensor], metadata: dict[str, str]) -> None:
    """Write safetensors from the tensors' memory; the library's own writers copy all of it."""
    header: dict[str, Any] = {"__metadata__": metadata}
    end = 0
    for key, tensor in tensors.items():
        start, end = end, end + tensor.numel() * tensor.element_size()
        header[key] = {
            "dtype": _DTYPES[tensor.dtype],
            "shape": list(tensor.shape),
            "data_offsets": [start, end],
        }
    encoded = json.dumps(header).encode()
    encoded += b" " * (-len(encoded) % 8)
    file.write(struct.pack("<Q", len(encoded)))
    file.write(encoded)
    for tensor in tensors.values():
        file.write(_memory(tensor))


def _memory(tensor: torch.Tensor) -> memoryview:
    """Bytes of a contiguous tensor."""
    return tensor.numpy().data.cast("B") if tensor.numel() else memoryview(b"")


def _tensors(path: Path, keys: Sequence[str]) -> dict[str, torch.Tensor]:
    """Read the tensors called `keys` into their own memory.

    safetensors returns views of the mapped file, which counts as memory once it is read; reopening
    the file releases it. Each opening parses the whole header, so their number is bounded.
    """
    from safetensors import safe_open

    found: dict[str, torch.Tensor] = {}
    enough = path.stat().st_size // _OPENINGS
    waiting = iter(keys)
    while len(found) < len(keys):
        read = 0
        with safe_open(path, framework="pt") as file:
            for key in waiting:
                found[key] = file.get_tensor(key).clone()
                read += found[key].nbytes
                if read > enough:
                    break
    return found


def _facts(tensor: torch.Tensor) -> list[Any]:
    """Properties that are verified on reading: dtype, shape and CRC-32 of the bytes."""
    return [_DTYPES[tensor.dtype], list(tensor.shape), zlib.crc32(_memory(tensor))]


def _check_intact(
    text: str, crc: str | None, content: dict[str, Any], tensors: dict[str, torch.Tensor]
) -> None:
    """Raise ValueError unless metadata and tensors are as written."""
    if str(zlib.crc32(text.encode())) != crc:
        raise ValueError("its metadata is damaged")
    found = {key: _facts(tensor.contiguous()) for key, tensor in tensors.items()}
    stated = content.get("tensors")
    if not isinstance(stated, dict):
        raise ValueError("it has no list of its tensors")
    if found != stated:
        broken = sorted(k for k in found.keys() | stated.keys() if found.get(k) != stated.get(k))
        raise ValueError(f"damaged: {', '.join(broken[:3])}")

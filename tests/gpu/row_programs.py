"""What programs of the tests do with rows on a device, and with the same rows of the CPU engine.

Functions that start with `print_` print one line of JSON.
"""

import hashlib
import resource
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gscore.engine.base import RowEdit, ShUpdate
from gscore.engine.cpu.engine import CpuEngine
from gscore.engine.cpu.model import CpuModel, Moments, morton_bounds
from gscore.engine.cpu.splat_terms import add_noise
from gscore.engine.gpu.model import GpuModel
from gscore.errors import BackendError
from gscore.raster.gpu.gpu_raster import GpuRaster
from gscore.raster.random_numbers import normal_rows
from gscore.raster.request import Frustum, Settings
from gscore.splats import PARAMETERS, SH_REST_BY_DEGREE
from tests.gpu.programs import _opened, _print

COUNTERS = "grad2d", "views", "third"
ROWS = 1003
"""Neither a multiple of 256 nor of 4."""
Saved = Mapping[str, np.ndarray]


def random_columns(random: np.random.Generator, count: int, degree: int) -> dict[str, np.ndarray]:
    """Raw parameters."""
    rest = SH_REST_BY_DEGREE[degree]
    shapes = ((3,), (4,), (3,), (), (1, 3), (rest, 3))
    return {
        name: random.normal(size=(count, *shape)).astype(np.float32)
        for name, shape in zip(PARAMETERS, shapes, strict=True)
    }


def random_model(random: np.random.Generator, count: int, degree: int) -> CpuModel:
    """A model of the CPU with random moments, accumulated gradients and counters."""

    def like(columns: Saved, name: str) -> torch.Tensor:
        return torch.from_numpy(random.normal(size=columns[name].shape).astype(np.float32))

    columns = random_columns(random, count, degree)
    moments = {
        name: Moments(
            like(columns, name), like(columns, name).abs(), 5, like(columns, "shN")
        )._replace(accumulated=like(columns, name))
        for name in PARAMETERS
    }
    tensors = {name: torch.from_numpy(column) for name, column in columns.items()}
    model = CpuModel(tensors, moments, counters=COUNTERS, threads=1)
    for name in COUNTERS:
        model.rows[name] = torch.from_numpy(random.normal(size=count).astype(np.float32))
    return model


def copies(saved: Saved) -> dict[str, np.ndarray]:
    return {name: column.copy() for name, column in saved.items()}


def uploaded(raster: GpuRaster, model: CpuModel, frozen: Saved | None = None) -> GpuModel:
    """The same model on the device."""
    return GpuModel.load(raster, copies(model.save()), model.adam_steps, frozen=frozen)


def difference(name: str, a: np.ndarray, b: np.ndarray, tolerance: float) -> list[str]:
    """What differs between two arrays, as a sentence; equal bits where `tolerance` is 0."""
    if a.shape != b.shape or a.dtype != b.dtype:
        return [f"{name}: {a.dtype} {a.shape} and {b.dtype} {b.shape}"]
    if tolerance == 0:
        equal = a.tobytes() == b.tobytes()
    else:
        equal = bool(np.allclose(a, b, rtol=tolerance, atol=tolerance))
    return [] if equal else [f"{name} differs"]


def compared(
    gpu: GpuModel, cpu: CpuModel, tolerances: Mapping[str, float] | None = None
) -> list[str]:
    """What differs between checkpoints of both models."""
    found, expected, of = gpu.save(), cpu.save(), tolerances or {}
    if found.keys() != expected.keys():
        return [f"the names differ: {sorted(found.keys() ^ expected.keys())}"]
    return [
        text
        for name, column in found.items()
        for text in difference(name, column, expected[name], of.get(name, 0))
    ]


def some(random: np.random.Generator, count: int, of: int) -> np.ndarray:
    """Different rows in random order."""
    return random.permutation(of)[:count].astype(np.int64)


def edits(random: np.random.Generator, count: int, rest: int) -> dict[str, RowEdit]:
    """Edits of all kinds of `count` rows, by name."""

    def numbers(*shape: int) -> np.ndarray:
        return random.normal(size=shape).astype(np.float32)

    half, few = count // 2, count // 10
    rows, none = some(random, half, count), np.zeros(0, np.int64)
    moved = some(random, 2 * few, count)
    parents = random.integers(0, max(count, 1), count * 3).astype(np.int64)[: count * 3]
    values = {"opacities": numbers(half), "shN": numbers(half, rest, 3), "views": numbers(half)}
    changes = {"means": numbers(count * 3, 3), "scales": numbers(count * 3, 3)}
    moves = {"moved": moved[:few], "sources": moved[few // 2 :][:few]}  # some are moved themselves
    return {
        "nothing": RowEdit(),
        "values": RowEdit(rows=rows, values=values),
        "all values": RowEdit(values={"sh0": numbers(count, 1, 3), "third": numbers(count)}),
        "forget": RowEdit(rows=rows, forget=("opacities", "quats", "shN")),
        "forget all": RowEdit(forget=("means", "sh0")),
        "moved": RowEdit(**moves),
        "fewer": RowEdit(keep=rows),
        "more": RowEdit(parents=parents, changes=changes),
        "as many": RowEdit(keep=rows, parents=parents[:half]),
        "order": RowEdit(keep=some(random, count, count)),
        "everything": RowEdit(
            rows=rows,
            values=values,
            forget=("scales", "shN"),
            **moves,
            keep=some(random, count - few, count),
            parents=parents,
            changes=changes,
        ),
        "no rows": RowEdit(rows=none, values={"means": numbers(0, 3)}, forget=("shN",)),
        "no moves": RowEdit(moved=none, sources=none, parents=none),
        "none": RowEdit(keep=none),
    }


def check_edits(raster: GpuRaster) -> list[str]:
    """Each edit of each degree, the edits after one another, with frozen rows in front."""
    problems = []
    for degree in range(4):
        random = np.random.default_rng(degree)
        cpu = random_model(random, ROWS, degree)
        frozen = random_columns(random, 37, min(degree, 1)) if degree % 2 else None
        gpu = uploaded(raster, cpu, frozen)
        count = len(cpu)
        for name in edits(random, count, 0):
            edit = edits(random, len(cpu), SH_REST_BY_DEGREE[degree])[name]
            cpu.edit(edit)
            gpu.edit(edit)
            problems += [f"{name}, degree {degree}: {p}" for p in compared(gpu, cpu)]
            if len(cpu) > 5 * ROWS:
                fewer = RowEdit(keep=np.arange(0, len(cpu), 7))
                cpu.edit(fewer)
                gpu.edit(fewer)
    return problems


def check_frozen(raster: GpuRaster) -> list[str]:
    """Pictures after edits: those of frozen splats and the columns, copied to the device again."""
    random, problems = np.random.default_rng(12), []
    K = np.array([[30, 0, 20], [0, 30, 15], [0, 0, 1]], np.float32)
    view = Frustum(np.eye(4, dtype=np.float32), K, 40, 30)
    frozen = random_columns(random, 300, 0)
    gpu = GpuModel(raster, random_columns(random, ROWS, 0), counters=("views",), frozen=frozen)
    changes: tuple[Callable[[], Any], ...] = (
        lambda: None,
        partial(gpu.edit, RowEdit(keep=np.arange(700), parents=np.arange(1000), morton=True)),
        partial(gpu.widen_sh, 2),
        partial(gpu.clamp_runaways, 1e-3),
        partial(gpu.edit, RowEdit(keep=np.arange(7))),
        partial(gpu.edit, RowEdit(keep=np.arange(0))),
    )
    for change in changes:
        change()
        degree = gpu.sh_degree
        wide = frozen | {"shN": np.zeros((300, SH_REST_BY_DEGREE[degree], 3), np.float32)}
        arrays = [np.concatenate([wide[name], gpu.column(name)]) for name in PARAMETERS]
        found, expected = (
            {"rgb": np.zeros((30, 40, 3), np.float32), "alpha": np.zeros((30, 40), np.float32)}
            for _ in range(2)
        )
        gpu.rows.draw(view, Settings(), found, sh_degree=degree)
        raster.forward(arrays, view, Settings(), expected)
        problems += difference("picture", found["rgb"], expected["rgb"], 0)
        problems += [] if found["alpha"].max() > 0.5 else ["the picture is empty"]
    return problems


def check_columns(raster: GpuRaster) -> list[str]:
    """Columns, some of their rows, and parts."""
    random, problems = np.random.default_rng(3), []
    cpu = random_model(random, ROWS, 2)
    gpu = uploaded(raster, cpu, random_columns(random, 300, 0))
    rows = some(random, 400, ROWS)
    twice = np.concatenate([rows, rows])
    for name in gpu.widths:
        problems += difference(name, gpu.column(name), cpu.column(name), 0)
        problems += difference(name, gpu.gather(name, twice), cpu.gather(name, twice), 0)
    for begin, end in ((0, ROWS), (1000, 2000), (17, 290), (5, 5)):
        there = cpu.part(begin, end)
        for name, part in gpu.part(begin, end).items():
            problems += difference(f"{name} {begin}", part, there[name], 0)
    return problems


def check_degrees(raster: GpuRaster) -> list[str]:
    """SH coefficients of one more degree at a time, then of an edit."""
    problems = []
    random = np.random.default_rng(4)
    for steps in ((0, 1, 2, 3), (1, 3), (2, 1)):
        cpu = random_model(random, ROWS, steps[0])
        gpu = uploaded(raster, cpu, random_columns(random, 5, 0))
        for degree in steps[1:]:
            cpu.widen_sh(degree)
            gpu.widen_sh(degree)
            problems += [f"degree {degree}: {p}" for p in compared(gpu, cpu)]
        edit = RowEdit(keep=some(random, 700, ROWS), parents=some(random, 900, ROWS))
        cpu.edit(edit)
        gpu.edit(edit)
        problems += compared(gpu, cpu)
    return problems


def runaways(random: np.random.Generator, degree: int) -> CpuModel:
    """A model with all that `clamp_runaways` is for."""
    model = random_model(random, ROWS, degree)
    for tensor in (*model.params.values(), *(model.moments(name)[1] for name in PARAMETERS)):
        flat = tensor.flatten()
        for bad in (np.nan, -np.nan, np.inf, -np.inf, 1e38, -1e38, 1.0001e4, 3e6, 8.0, 25.0, -25.0):
            for at in random.integers(0, max(len(flat), 1), 3) if len(flat) else ():
                flat[int(at)] = bad
    scales = model.params["scales"]
    scales[::7] = scales[::7] * 4
    model.params["means"][::5] *= 100
    return model


def check_clamps(raster: GpuRaster) -> list[str]:
    """Runaway rows of every degree; logarithms of distances within 1e-6."""
    problems = []
    for degree in range(4):
        random = np.random.default_rng(degree)
        cpu = runaways(random, degree)
        gpu = uploaded(raster, cpu, random_columns(random, 300, 0) if degree > 1 else None)
        for extent in (2.5, 2.5, 0.01):
            expected = cpu.clamp_runaways(extent)
            found = gpu.clamp_runaways(extent)
            if found != expected:
                problems.append(f"{found} rows are reset, and {expected} on the CPU")
            problems += [f"{degree}: {p}" for p in compared(gpu, cpu, {"param/scales": 1e-6})]
    calm = random_model(np.random.default_rng(8), ROWS, 1)
    gpu = uploaded(raster, calm)
    if calm.clamp_runaways(1e3) or gpu.clamp_runaways(1e3):
        problems.append("rows are reset")
    return problems + compared(gpu, calm)


def check_noise(raster: GpuRaster) -> list[str]:
    """Noise of faint splats; of a row around the origin the noise itself."""
    problems = []
    for weight, frozen in ((0.3, None), (1e4, 300)):
        random = np.random.default_rng(6)
        cpu = random_model(random, ROWS, 0)
        cpu.params["opacities"] -= 5
        cpu.params["scales"] *= 0.1  # large ratios amplify rounding
        cpu.params["means"][::2] = 0
        before = None if frozen is None else random_columns(random, frozen, 0)
        gpu = uploaded(raster, cpu, before)
        key = {"seed": 2**62 + 12345678901, "step": 4_000_000_000, "stream": 3}
        add_noise(cpu, weight, partial(normal_rows, **key))
        gpu.rows.noise(weight, **key)
        found, expected = gpu.column("means"), cpu.column("means")
        error = np.abs(found - expected).max(1) / np.abs(expected).max(1).clip(1e-30)
        if error.max() > 2e-6:
            problems.append(f"weight {weight}: {error.max():.1e}")
        cpu.params["means"].copy_(torch.from_numpy(found))
        problems += compared(gpu, cpu)
    return problems


def check_morton(raster: GpuRaster) -> list[str]:
    """Orders of all rows and of some: that of numpy's float32 keys, and of the CPU where no mean is
    near the border of a cell."""
    problems = []
    for count in (9001, 4096, 255, 1):
        random = np.random.default_rng(count)
        cpu = random_model(random, count, 0)
        means = cpu.params["means"]
        means[: count // 3] = means[count // 3 : 2 * (count // 3)]  # rows of one cell
        if count > 1000:
            means[5:9] = torch.tensor([np.nan, np.inf, -np.inf, -1e30])[:, None]
        gpu = uploaded(raster, cpu, random_columns(random, 11, 0))
        rows = some(random, count - count // 4, count)
        low, high = morton_bounds(means.numpy()[rows])
        found = gpu.rows.morton_order(low, high, rows)
        problems += difference(f"{count}", found, _order(means.numpy()[rows], low, high), 0)
        with np.errstate(over="ignore"):
            cpu.edit(RowEdit(morton=True))
        gpu.edit(RowEdit(morton=True))
        same = (gpu.column("opacities") == cpu.column("opacities")).mean()
        if same < 0.9:
            problems.append(f"{count} rows: {same:.3f} in the CPU's order")
        # A permutation of rows moves all tables alike: sorted again on the CPU they are equal.
        problems += _sorted_difference(gpu, cpu)
    same_place = GpuModel(raster, random_columns(np.random.default_rng(1), 600, 0))
    same_place.edit(RowEdit(values={"means": np.ones((600, 3), np.float32)}))
    before = same_place.column("scales")
    same_place.edit(RowEdit(morton=True))
    return problems + difference("one cell", same_place.column("scales"), before, 0)


def _order(means: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Order of the keys of morton.comp."""
    least, most = low.astype(np.float32), high.astype(np.float32)
    scale = (1023 / np.maximum(most.astype(float) - least, 1e-30)).astype(np.float32)
    with np.errstate(over="ignore"):
        cells = (np.nan_to_num(means) - least) * scale
    cells = np.clip(cells, 0, 1023).astype(np.uint32)
    key = np.zeros(len(means), np.uint32)
    for bit in range(10):
        for axis in range(3):
            key |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable").astype(np.uint32)


def _sorted_difference(gpu: GpuModel, cpu: CpuModel) -> list[str]:
    """What differs between checkpoints whose rows are sorted by a counter."""
    found, expected = gpu.save(), cpu.save()
    a, b = np.argsort(found["row/third"]), np.argsort(expected["row/third"])
    names = [name for name in found if name != "drift"]
    return [
        text for name in names for text in difference(name, found[name][a], expected[name][b], 0)
    ]


def check_checkpoints(raster: GpuRaster) -> list[str]:
    """A checkpoint of the device is loaded by both engines; one of the CPU with pending steps is
    synchronised on its way up."""
    random = np.random.default_rng(9)
    cpu = random_model(random, ROWS, 3)
    cpu.set_rates(dict.fromkeys(PARAMETERS, 0.01))
    for _ in range(3):
        for grad in cpu.grads.values():
            grad.copy_(torch.from_numpy(random.normal(size=grad.shape).astype(np.float32)))
        radii = torch.from_numpy(random.integers(0, 2, ROWS).astype(np.int32))
        cpu.step(radii, shN=ShUpdate.STEP)
    waiting = int(cpu.rows["shN_pending"].count_nonzero())
    problems = [] if waiting > 100 else [f"only {waiting} rows wait"]
    gpu = uploaded(raster, cpu)
    cpu.sync()
    expected = {
        name: column
        for name, column in cpu.save().items()
        if name not in ("drift", "row/shN_seen", "row/shN_lag")
    }
    saved = gpu.save()
    for name, column in expected.items():
        problems += difference(name, saved[name], column, 0)
    again = GpuModel.load(raster, copies(saved), gpu.adam_steps).save()
    for name, column in saved.items():
        problems += difference(f"again {name}", again[name], column, 0)
    restored = CpuEngine(threads=1).load(copies(saved), gpu.adam_steps).save()
    for name, column in saved.items():
        problems += difference(f"on the CPU {name}", restored[name], column, 0)
    if gpu.adam_steps != cpu.adam_steps:
        problems.append("adam_steps differ")
    return problems


def check_ends(raster: GpuRaster) -> list[str]:
    """A model without moments can be read and changed; a closed one is refused."""
    random = np.random.default_rng(10)
    cpu = random_model(random, ROWS, 1)
    gpu = uploaded(raster, cpu)
    for _ in range(2):
        gpu.finish()
    gpu.edit(RowEdit(keep=np.arange(500), parents=np.arange(900)))
    gpu.widen_sh(2)
    cpu.edit(RowEdit(keep=np.arange(500), parents=np.arange(900)))
    cpu.widen_sh(2)
    cpu.drop_moments()
    problems = compared(gpu, cpu)
    for refused in (
        partial(gpu.gather, "means", np.array([1400])),
        partial(gpu.gather, "means", np.array([-1])),
        partial(gpu.clamp_runaways, 1.0),
        partial(gpu.edit, RowEdit(forget=("means",))),
    ):
        problems += [] if _message(refused) else [f"{refused} is not refused"]
    gpu.close()
    problems += [] if _message(partial(gpu.column, "means")) else ["a closed model is read"]
    return problems


def _message(call: Callable[[], Any]) -> str:
    """The message of the error that a call raises; empty: none."""
    try:
        call()
    except (BackendError, ValueError) as error:
        return str(error)
    return ""


CHECKS: dict[str, Callable[[GpuRaster], list[str]]] = {
    "columns": check_columns,
    "frozen": check_frozen,
    "edits": check_edits,
    "degrees": check_degrees,
    "clamps": check_clamps,
    "noise": check_noise,
    "morton": check_morton,
    "checkpoints": check_checkpoints,
    "ends": check_ends,
}


def print_row_problems() -> None:
    """What differs from the CPU's, by name of the check, and a hash of what may."""
    with _opened() as raster:
        found = {name: check(raster) for name, check in CHECKS.items()}
        cpu = runaways(np.random.default_rng(2), 1)
        cpu.params["opacities"] -= 5
        gpu = uploaded(raster, cpu)
        gpu.clamp_runaways(2.5)
        gpu.rows.noise(0.3, seed=5, step=6, stream=7)
        gpu.edit(RowEdit(morton=True))
        content = hashlib.sha256(b"".join(column.tobytes() for column in gpu.save().values()))
        _print({"problems": found, "hash": content.hexdigest()})


def print_short_memory() -> None:
    """Messages where rows do not fit: into one buffer, into memory, into 32-bit numbers; and what
    changed in the model."""
    with _opened() as raster:
        cpu = random_model(np.random.default_rng(11), 20_003, 3)
        gpu = uploaded(raster, cpu)
        messages = [
            _message(partial(gpu.rows.reserve, 10_000_000)),
            _message(partial(gpu.rows.reserve, 100_000_000)),
        ]
        parents = np.zeros(400_000, np.int64)
        edit = RowEdit(values={"opacities": np.zeros(20_003, np.float32)}, parents=parents)
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        unlimited = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (size + (300 << 20), unlimited[1]))
        messages.append(_message(partial(gpu.edit, edit)))
        resource.setrlimit(resource.RLIMIT_AS, unlimited)
        changed = compared(gpu, cpu)
        gpu.edit(edit)
        cpu.edit(edit)
        _print({"messages": messages, "changed": changed, "after": compared(gpu, cpu)})

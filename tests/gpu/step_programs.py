"""Training steps of random sizes and options, on a device and on the CPU; the function that starts
with `print_` prints one line of JSON."""

import hashlib
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from gscore.engine.base import (
    Columns,
    ShUpdate,
    StepNumbers,
    StepPhoto,
    StepRequest,
    TermGradients,
    TermKind,
)
from gscore.engine.cpu.engine import CpuEngine
from gscore.raster.request import Frustum
from gscore.splats import PARAMETERS, SH_REST_BY_DEGREE
from tests.gpu.engines import software_engine

COUNTS = 0, 1, 2, 255, 256, 257, 511, 513, 1000
SIDES = 1, 2, 7, 15, 16, 17, 31, 33, 48, 65, 97
"""Around the sizes of workgroups, tiles and windows."""
COUNTERS = "grad2d", "views"


@dataclass(frozen=True)
class RandomSteps:
    """A model, a photo, and requests of steps."""

    columns: Columns
    frozen: Columns | None
    photo: StepPhoto
    requests: tuple[StepRequest, ...]


def _columns(random: np.random.Generator, count: int, degree: int) -> Columns:
    rest = SH_REST_BY_DEGREE[degree]
    found = {
        "means": random.uniform(-1, 1, (count, 3)) * (1.2, 1.2, 1) + (0, 0, 3),
        "quats": random.normal(size=(count, 4)),
        "scales": np.log(random.uniform(0.01, 0.3, (count, 3))),
        "opacities": random.normal(size=count) * 2,
        "sh0": random.normal(size=(count, 1, 3)),
        "shN": random.normal(size=(count, rest, 3)) * 0.2,
    }
    return {name: column.astype(np.float32) for name, column in found.items()}


def _term(inverse_depth: np.ndarray, alpha: np.ndarray) -> TermGradients:
    v = np.full_like(alpha, 1e-3)
    return TermGradients(float(inverse_depth.mean()), v, -0.1 * v)


def random_steps(seed: int) -> RandomSteps:
    """Four steps, which with SH coefficients accumulate and apply their gradients in turn."""
    random = np.random.default_rng(seed)
    width, height = (int(random.choice(SIDES)) for _ in range(2))
    degree = int(random.integers(4))

    def by_chance(share: float, value: Any, otherwise: Any) -> Any:
        return value if random.random() < share else otherwise

    columns = _columns(random, int(random.choice(COUNTS)), degree)
    fewer = int(random.integers(degree + 1))
    frozen = by_chance(0.3, _columns(random, int(random.choice((1, 5, 300))), fewer), None)
    mode = str(random.choice(("none", "composite", "ignore")))
    mask = random.integers(0, 256, (height, width)).astype(np.uint8)
    mask[: height // 2] *= mode != "ignore"
    image = random.integers(0, 256, (height, width, 3)).astype(np.uint8)
    photo = StepPhoto(image=image, mask=mask, mask_mode=mode, counted=0.5)
    if mode == "none":
        photo = StepPhoto(image=image)
    terms = ((TermKind.L1, 0.8), (TermKind.SSIM, 0.2))
    terms += by_chance(0.5, ((TermKind.MASK_ALPHA, 0.1),), ()) if mode == "composite" else ()
    K = np.array([[0.9 * width, 0, width / 2], [0, 0.9 * width, height / 2], [0, 0, 1.0]])
    viewmat = np.eye(4)
    viewmat[:3, 3] = random.normal(size=3) * 0.05
    r, g, b = (float(one) for one in random.random(3))
    options: dict[str, Any] = {
        "photo": 0,
        "view": Frustum(viewmat, K, width, height),
        "background": (r, g, b),
        "shown_background": (b, g, r),
        "sh_degree": degree,
        "rates": dict.fromkeys(PARAMETERS, 1e-3),
        "terms": terms + by_chance(0.3, ((TermKind.SEE_THROUGH, 0.05),), ()),
        "observe": COUNTERS,
        "extent": 1.0,
        "seed": seed,
        "antialias": by_chance(0.4, True, False),
        "gain": by_chance(0.4, (0.9, 1.1, 1.05), None),
        "learn_pose": by_chance(0.5, True, False),
        "drop_rate": by_chance(0.3, 0.2, 0.0),
        "noise": by_chance(0.3, 1e-3, 0.0),
        "opacity_reg": by_chance(0.3, 0.01, 0.0),
        "scale_reg": by_chance(0.3, 0.01, 0.0),
    }
    term = by_chance(0.25, _term, None)
    options["blur"] = by_chance(0.4, (3.0, -1.0, 2.0), None)
    updates = (ShUpdate.STEP, ShUpdate.ACCUMULATE) if degree else (ShUpdate.OFF,) * 2
    requests = tuple(
        StepRequest(
            step=step,
            sh_update=updates[step % 2],
            picture_term=term if step == 2 else None,
            **options,
        )
        for step in range(1, 5)
    )
    return RandomSteps(columns, frozen, photo, requests)


def _taken(engine: Any, steps: RandomSteps) -> tuple[Any, list[StepNumbers]]:
    """The model after the steps, all of them in flight at once, and their results."""
    model = engine.model(steps.columns, counters=COUNTERS, frozen=steps.frozen)
    pending = []
    for request in steps.requests:
        engine.put(0, steps.photo)
        pending.append(engine.step(model, request))
    return model, [one.result() for one in pending]


def _problems(
    of: tuple[Any, list[StepNumbers]], cpu: tuple[Any, list[StepNumbers]]
) -> Iterator[str]:
    """What differs; a few numbers may, because Adam turns tiny gradients into whole steps."""
    for a, b in zip(of[1], cpu[1], strict=True):
        if not np.allclose((a.loss, a.mse), (b.loss, b.mse), rtol=2e-4, atol=1e-6):
            yield f"step {a.step}: loss {a.loss} and {b.loss}, mse {a.mse} and {b.mse}"
        if np.abs(a.slopes - b.slopes).max() > 3e-3 * max(np.abs(b.slopes).max(), 1e-3):
            yield f"step {a.step}: slopes"
        if (a.bad_rows, a.lost_rows, a.skipped) != (b.bad_rows, b.lost_rows, b.skipped):
            yield f"step {a.step}: rows"
    expected = cpu[0].synced()
    for name in (*PARAMETERS, *COUNTERS):
        known = expected[name].numpy() if name in expected else cpu[0].column(name)
        difference = np.abs(of[0].column(name) - known)
        if difference.size and ((difference > 2e-5).mean() > 0.02 or difference.max() > 0.01):
            yield f"{name}: {difference.max()}"


def print_random_steps(count: int, *, compares: bool = True) -> None:
    """Hash of all models and numbers of the device; if `compares`, what differs from the CPU's."""
    engine, content = software_engine(), hashlib.sha256()
    problems: list[str] = []
    for seed in range(count):
        steps = random_steps(seed)
        found = _taken(engine, steps)
        for name, column in sorted(found[0].save().items()):
            content.update(name.encode() + column.tobytes())
        content.update(repr([(one.loss, one.slopes.tolist()) for one in found[1]]).encode())
        if compares:  # the CPU's engine keeps the frozen splats of its first model
            differences = _problems(found, _taken(CpuEngine(threads=1), steps))
            problems += [f"{seed}: {one}" for one in differences]
    engine.close()
    sys.stdout.write(f"\n{json.dumps({'hash': content.hexdigest(), 'problems': problems})}\n")

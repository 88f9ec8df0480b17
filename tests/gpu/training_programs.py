"""Trainings on a device and on the CPU, of a toy capture; each function prints one line of JSON."""

import hashlib
import json
import sys
from dataclasses import replace
from typing import Any

import numpy as np

from gscore.config import TrainConfig
from gscore.engine.base import Engine, RowEdit, StepPhoto, TermGradients
from gscore.engine.cpu.engine import CpuEngine
from gscore.stress.capture import toy_photos, toy_splats
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.estimate.device_memory import device_bytes
from gscore.trainer.trainer import Trainer
from tests.engine.test_contract import COUNTERS, columns_of, request_of
from tests.gpu.engines import software_engine
from tests.trainer.short_run import CONFIG

SHORT = replace(CONFIG, sh_degree=3, shN_every=4)
CASES: dict[str, dict[str, Any]] = {
    "default": {},
    "mcmc": {"strategy": "mcmc", "refine_start": 15, "scale_reg": 0.02},
    "every option": {
        "antialias": True,
        "drop_rate": 0.1,
        "opaque_weight": 0.01,
        "alpha_weight": 0.1,
        "exposure": "on",
        "refine_poses": "on",
        "prune_share": 0.3,
        "finest": 0.3,
    },
    "two models": {"ensemble": 2, "refine_start": 15},
}
"""Options of a training by its name."""


def trainer_of(
    case: str, engine: Engine[Any], size: int, mask: str = "none", **options: Any
) -> Trainer:
    """A training of the toy capture with photos of `size` px."""
    photos = toy_photos(size=size)
    if mask != "none":
        y, x = np.mgrid[:size, :size] - size / 2
        disc = (255 * (np.hypot(x, y) < 0.45 * size)).astype(np.uint8)
        photos = replace(photos, masks=[disc for _ in photos.images], mask_mode=mask)
    config: TrainConfig = replace(SHORT, **(CASES[case] | options))
    return Trainer(config, Analysis(photos=photos), engine=engine)


def hash_of(trainer: Trainer) -> str:
    """Hash of all that the next step depends on."""
    trainer.read_all()
    content = hashlib.sha256()
    for name, tensor in sorted(trainer.tensors().items()):
        content.update(name.encode() + tensor.numpy().tobytes())
    return content.hexdigest()


def print_trainings(cases: str, steps: int, size: int = 32) -> None:
    """By case, whose mask mode may follow a colon: hashes of two trainings on the device, and the
    root mean squared errors and numbers of splats of the first and of one on the CPU."""
    found = {}
    for name in cases.split(","):
        case, _, mask = name.partition(":")
        hashes, errors, counts = [], [], []
        for make in (software_engine, software_engine, CpuEngine):
            trainer = trainer_of(case, make(), size, mask or "none")
            for _ in range(steps):
                trainer.step() if make is CpuEngine else trainer.advance()
            hashes.append(hash_of(trainer))
            errors.append(trainer.error())
            counts.append(trainer.splat_count)
            trainer.engine.close()
        found[name] = {"hashes": hashes[:2], "errors": errors[1:], "counts": counts[1:]}
    sys.stdout.write(f"\n{json.dumps(found)}\n")


def print_hash(case: str, steps: int, size: int, mask: str) -> None:
    """Hash of a training on the device."""
    trainer = trainer_of(case, software_engine(), size, mask)
    for _ in range(steps):
        trainer.advance()
    sys.stdout.write(f"\n{json.dumps(hash_of(trainer))}\n")


def print_submissions(steps: int) -> None:
    """Hash of a training on the device, and how often each kernel of it ran."""
    engine = software_engine()
    trainer = trainer_of("every option", engine, 96)
    engine._raster.profile(True)
    for _ in range(steps):
        trainer.advance()
    found = hash_of(trainer)
    calls = {name: calls for name, (_, calls) in engine._raster.kernel_times().items() if calls}
    sys.stdout.write(f"\n{json.dumps({'hash': found, 'calls': calls})}\n")


def print_blurred(steps: int) -> None:
    """Hash of a model after steps with blurs of several sizes, their losses, and how often each
    kernel of them ran."""
    engine = software_engine()
    photos = toy_photos(splats=toy_splats(count=40), size=96)
    model = engine.model(columns_of(toy_splats(count=40)), counters=COUNTERS)
    engine._raster.profile(True)
    pending = []
    for step in range(steps):
        engine.put(0, StepPhoto(image=photos.image(0)))
        request = request_of(photos, 0, 1 + step, blur=(200.0 / (1 + step), 30.0, 90.0))
        pending.append(engine.step(model, request))
    losses = [one.result().loss for one in pending]
    calls = {name: calls for name, (_, calls) in engine._raster.kernel_times().items() if calls}
    content = hashlib.sha256()
    for _, column in sorted(model.save().items()):
        content.update(column.tobytes())
    found = {"hash": content.hexdigest(), "losses": losses, "calls": calls}
    sys.stdout.write(f"\n{json.dumps(found)}\n")


def print_continued(steps: int, *stops: int) -> None:
    """Hashes of a training, and of those that another engine continues from its state at
    each of the steps `stops`; root mean squared errors of one that goes from the CPU to the device
    and back."""
    whole = trainer_of("default", software_engine(), 32)
    for _ in range(steps):
        whole.advance()
    hashes = [hash_of(whole)]
    for stop in stops:
        first, second = (trainer_of("default", software_engine(), 32) for _ in range(2))
        for _ in range(stop):
            first.advance()
        _continue(first, second)
        for _ in range(steps - stop):
            second.advance()
        hashes.append(hash_of(second))
    engines = (CpuEngine(), software_engine(), CpuEngine())
    trainers = [trainer_of("default", one, 32) for one in engines]
    for i, one in enumerate(trainers):
        if i:
            _continue(trainers[i - 1], one)
        for _ in range(steps // 3):
            one.advance()
    errors = [one.error() for one in (whole, trainers[-1])]
    rows = len(trainers[-1].splats().means)
    sys.stdout.write(f"\n{json.dumps({'hashes': hashes, 'errors': errors, 'rows': rows})}\n")


def _continue(before: Trainer, after: Trainer) -> None:
    before.read_all()
    state = json.loads(json.dumps(before.state()))
    after.restore(state, {name: one.clone() for name, one in before.tensors().items()})


def print_photos() -> None:
    """By the photos that may stay on the device, none, three or all: the hash of a training with
    masks, whose photos grow, and the number of those that stayed; the last without enough memory
    for them and the growing model."""
    found = []
    for count in (0, 3, 99):
        trainer = trainer_of("default", software_engine(), 32, "ignore", coarse_factor=2.0)
        engine: Any = trainer.engine
        engine.keep_photos(count * 32 * 32 * 4)
        for _ in range(60):
            trainer.advance()
        found.append([hash_of(trainer), len(engine._kept)])
        engine.close()
    sys.stdout.write(f"\n{json.dumps(found)}\n")


def print_short_room(rows: int) -> None:
    """A device whose memory is filled with photos: how many stay there, and how many after a model
    has grown to `rows`; the steps that were taken before and after that."""
    engine = software_engine()
    engine.keep_photos(1 << 40)
    photos = toy_photos(size=200)
    model = engine.model(columns_of(toy_splats(count=500)), counters=COUNTERS)
    photo, kept, counts, taken = StepPhoto(image=photos.image(0)), engine._kept, [], 0
    for step in (1, 2):
        engine.put(0, photo)
        taken += not engine.step(model, request_of(photos, 0, step)).result().skipped
        key = 1
        while kept.handle_of(key, photo)[0] is not None and key < 2000:
            key += 1
        counts.append(len(kept))
        if step == 1:
            more = rows - len(model)
            model.edit(RowEdit(parents=np.resize(np.arange(len(model)), more)))
    sys.stdout.write(f"\n{json.dumps([counts, taken, len(model)])}\n")


def print_memory(rows: int, size: int) -> None:
    """Most bytes that a training took which grew to `rows` splats of SH degree 3, with pictures
    before and between its steps, contributions, masks, and a term that the trainer computes; and
    their forecast."""
    engine = software_engine()
    photos = toy_photos(size=size)
    columns = columns_of(toy_splats(count=rows // 2))
    columns["shN"] = np.zeros((rows // 2, 15, 3), np.float32)
    model = engine.model(columns, counters=COUNTERS)
    mask = np.full((size, size), 255, np.uint8)
    photo = StepPhoto(image=photos.image(0), mask=mask, mask_mode="ignore")

    def draw() -> None:
        black = {"background": (0.0, 0.0, 0.0), "antialias": False}
        engine.draw([model], request_of(photos, 0, 1).view, inverse_depth=True, **black)

    def term(inverse_depth: np.ndarray, alpha: np.ndarray) -> TermGradients:
        return TermGradients(0.0, np.zeros_like(alpha), np.zeros_like(alpha))

    draw()
    for step in range(1, 6):
        engine.put(0, photo)
        options = {"sh_degree": 3, "learn_pose": True, "gain": (1.0, 1.1, 0.9)}
        term_of = term if step == 4 else None
        engine.step(model, request_of(photos, 0, step, picture_term=term_of, **options))
        if step == 2:
            model.edit(RowEdit(parents=np.arange(len(model)), morton=True))
            draw()
    draw()
    view = request_of(photos, 0, 1).view
    assert list(engine.contributions(model, [(view, photo)], antialias=False))
    draw()
    assert len(model) == rows and len(model.save()["param/shN"]) == rows
    forecast = device_bytes(splats=rows, sh_degree=3, pixels=size * size)
    sys.stdout.write(f"\n{json.dumps([engine.peak_memory(), forecast])}\n")


def print_crowded() -> None:
    """Hashes of trainings whose entries do not fit into the first buffers, read at once and late,
    and the root mean squared errors of device and CPU."""
    hashes, errors = [], []
    for depth in (2, 0, -1):
        engine: Any = CpuEngine() if depth < 0 else software_engine()
        trainer = trainer_of("default", engine, 96)
        wide = np.zeros_like(trainer.model.column("scales"))
        trainer.model.edit(RowEdit(values={"scales": wide}))
        for _ in range(6):
            trainer.advance() if depth else trainer.step()
        hashes.append(hash_of(trainer))
        errors.append(trainer.error())
    sys.stdout.write(f"\n{json.dumps({'hashes': hashes, 'errors': errors})}\n")

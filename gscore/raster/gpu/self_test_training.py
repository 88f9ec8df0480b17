"""Training kernels of a device in its self-test: repeated, and compared with the CPU and numpy."""

import ctypes as ct
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ...shared_constants import ADAM_BETA1, ADAM_BETA2, ADAM_EPS
from ...splats import PARAMETERS
from .. import _native, arguments
from ..blend_weights import GEOMETRY, blending_weights
from ..buffers import UINT8, address
from ..header import MASK_MODES, BlurArgsStruct, LossArgsStruct
from ..request import Settings
from . import header
from .gpu_loss import gpu_image_loss
from .gpu_raster import GpuRaster
from .gpu_rows import GpuRows
from .self_test_gradients import gradient_problems
from .self_test_pictures import SelfTestScene, blank_pictures, drawn

_Result = tuple[list[str], dict[str, Any]]
_Triple = tuple[float, float, float]
_RATE = 1e-3
_BACKGROUND = (0.25, 0.5, 0.125)
_LOSS, _V_IMAGE, _WEIGHT, _SQUARE, _STEP = 1e-5, 1e-4, 1e-4, 1e-4, 1e-2
"""Largest differences: of a loss; relative to the largest number, of its gradient and of blending
weights; relative to each number, of second moments; relative to the rate, of Adam steps."""


def training_checks() -> Iterator[tuple[str, Callable[[GpuRaster], _Result]]]:
    """Name and function of each test."""
    yield "the loss of a picture", partial(_losses, mode="none", gain=None, blur=None)
    changed: dict[str, Any] = {"mode": "composite", "gain": (0.9, 1.2, 1.1)}
    yield "the loss with masks and gains", partial(_losses, **changed, blur=None)
    yield "the loss of a blurred picture", partial(_losses, **changed, blur=(3.0, 1.5, 2.0))
    yield "a training step", _step
    yield "blending weights", _weights
    yield "rows of splats", _rows


def _losses(raster: GpuRaster, *, mode: str, gain: _Triple | None, blur: _Triple | None) -> _Result:
    """Oracle: the CPU's loss and gradient; the same bits in a second computation."""
    random = np.random.default_rng(3)
    image = random.uniform(-0.1, 1.1, (45, 67, 3)).astype(np.float32)
    photo, mask = (random.integers(0, 256, (45, 67, *rgb), np.uint8) for rgb in ((3,), ()))
    options: dict[str, Any] = {"mask": None if mode == "none" else mask, "mask_mode": mode}
    options |= {"background": _BACKGROUND, "gain": gain, "blur": blur}
    first, second = (gpu_image_loss(raster, image, photo, **options) for _ in range(2))
    loss, v_image = _cpu_loss(image, photo, **options)
    problems = []
    if first.v_image.tobytes() != second.v_image.tobytes() or first.loss != second.loss:
        problems.append("it changes when it is computed again")
    if not abs(first.loss - loss) <= _LOSS:
        problems.append(f"it differs from the CPU's by {abs(first.loss - loss):.1e}")
    error = np.abs(first.v_image - v_image).max() / np.abs(v_image).max()
    if not error <= _V_IMAGE:
        problems.append(f"its gradient differs from the CPU's by {error:.1e}")
    return problems, {}


def _cpu_loss(
    image: np.ndarray,
    photo: np.ndarray,
    *,
    mask: np.ndarray | None = None,
    mask_mode: str = "none",
    background: _Triple = (0.0, 0.0, 0.0),
    gain: _Triple | None = None,
    blur: _Triple | None = None,
) -> tuple[float, np.ndarray]:
    """The CPU's loss and its gradient, [H, W, 3]."""
    image = image if blur is None else _cpu_blur(image, blur, adjoint=False)
    factors = None if gain is None else np.array(gain, np.float32)
    args = LossArgsStruct(
        width=image.shape[1],
        height=image.shape[0],
        image=address("image", image, image.shape),
        target=address("photo", photo, image.shape, UINT8),
        mask=None if mask is None else address("mask", mask, image.shape[:2], UINT8),
        mask_mode=MASK_MODES[mask_mode],
        background=(ct.c_float * 3)(*background),
        ssim_weight=0.2,
        gain=None if factors is None else address("gain", factors, (3,)),
    )
    v_image = np.empty_like(image)
    with _native.pool.lend() as cpu:
        loss = cpu.image_loss(args, v_image).loss
    return loss, v_image if blur is None else _cpu_blur(v_image, blur, adjoint=True)


def _cpu_blur(image: np.ndarray, covariance: _Triple, *, adjoint: bool) -> np.ndarray:
    """The CPU's blur of a picture, [H, W, 3], or of its gradient."""
    blurred = np.empty_like(image)
    args = BlurArgsStruct(
        width=image.shape[1],
        height=image.shape[0],
        image=address("image", image, image.shape),
        covariance=(ct.c_float * 3)(*covariance),
        adjoint=adjoint,
    )
    _native.blur_image(args, blurred)
    return blurred


def _step(raster: GpuRaster) -> _Result:
    """Oracle: the first moments against the CPU's gradients; second moments and steps of Adam
    (Kingma and Ba 2015) from the first moments in float64; the same bits in a second step."""
    scene = SelfTestScene(name="", count=900, settings=Settings(background=_BACKGROUND))
    photo = np.random.default_rng(4).integers(0, 256, (scene.height, scene.width, 3), np.uint8)
    first, second = _stepped(scene, photo, raster), _stepped(scene, photo, raster)
    problems = [
        f"{name} changes when the step is taken again"
        for name, found in first.items()
        if found.tobytes() != second[name].tobytes()
    ]
    splats, true = scene.splats(), _cpu_gradients(scene, photo)
    flat = {name: one.reshape(len(one), -1) for name, one in zip(PARAMETERS, splats, strict=True)}
    gradients = {"viewmat": first["viewmat"]}
    for name, values in flat.items():
        moment = first[f"moment1 {name}"].astype(np.float64)
        g = moment / (1 - ADAM_BETA1)
        gradients[name] = g.astype(np.float32).reshape(true[name].shape)
        square = first[f"moment2 {name}"]
        if not np.allclose(square, (1 - ADAM_BETA2) * g**2, rtol=_SQUARE, atol=1e-30):
            problems.append(f"the second moment of {name} is wrong")
        moved = values - _RATE * g / np.sqrt(g**2 + ADAM_EPS**2)
        limit = _STEP * _RATE + 2e-7 * np.abs(values)
        if not (np.abs(first[f"values {name}"] - moved) <= limit).all():
            problems.append(f"the step of {name} is wrong")
    return problems + gradient_problems(gradients, true), {}


def _stepped(scene: SelfTestScene, photo: np.ndarray, raster: GpuRaster) -> dict[str, np.ndarray]:
    """Tables by their names, and the gradient of the pose, after a step on a device."""
    splats = scene.splats()
    rows = GpuRows(raster, splats, counters=2)
    step = header.GpuStepStruct(
        view=arguments.view(scene.view(), scene.settings, scene.degree),
        photo=address("photo", photo, photo.shape, UINT8),
        mask_mode=MASK_MODES["none"],
        counted=1.0,
        ssim_weight=0.2,
        rates=(ct.c_float * 6)(*[_RATE] * 6),
        sh_update=header.SH_STEP,
        steps=(ct.c_int64 * 6)(*[1] * 6),
        gradient_counter=0,
        view_counter=1,
        learns_pose=1,
        updates=1,
        extent=1.0,
    )
    numbers = header.GpuStepNumbersStruct()
    lib = raster.library
    raster.call(lib.gs_gpu_step_request, rows.handle, ct.byref(step), 0, waits=False)
    raster.call(lib.gs_gpu_step_result, 0, ct.byref(numbers), waits=False)
    found = {"viewmat": np.array(numbers.v_viewmat[:], np.float32).reshape(4, 4)}
    tables = {"values": header.VALUES, "moment1": header.MOMENT1, "moment2": header.MOMENT2}
    for name, column in zip(PARAMETERS, splats, strict=True):
        width = int(np.prod(column.shape[1:], dtype=int))
        for table, number in tables.items():
            found[f"{table} {name}"] = rows.read(number, header.COMPONENTS[name], width)
    found["counters"] = rows.read(header.COUNTERS, 0, 2)
    rows.close()
    return found


def _cpu_gradients(scene: SelfTestScene, photo: np.ndarray) -> dict[str, np.ndarray]:
    """The CPU's gradients of the loss, by the names of gs_splat_grads."""
    splats, view, pictures = scene.splats(), scene.view(), blank_pictures(scene)
    found = {name: np.zeros_like(a) for name, a in zip(PARAMETERS, splats, strict=True)}
    found |= {"viewmat": np.zeros((4, 4), np.float32)}
    with _native.pool.lend() as cpu:
        cpu.forward(splats, view, scene.settings, pictures)
        v_rgb = _cpu_loss(pictures["rgb"], photo)[1]
        cpu.backward(splats, view, scene.settings, {"rgb": v_rgb}, found)
    return found


def _weights(raster: GpuRaster) -> _Result:
    """Oracle: the CPU's blending weights."""
    scene = SelfTestScene(name="")
    splats, view = scene.splats(), scene.view()
    size = view.height, view.width, 3
    shares = np.random.default_rng(0).uniform(0, 1, size).astype(np.float32)
    scratch = {name: np.zeros_like(a) for name, a in zip(GEOMETRY, splats, strict=False)}
    settings = replace(scene.settings, sh_degree=None)
    true = blending_weights(splats[: len(GEOMETRY)], view, settings, shares, scratch=scratch)
    drawn(scene, raster)
    error = np.abs(raster.weights(splats, scene.settings, shares, view) - true).max() / true.max()
    return [] if error <= _WEIGHT else [f"they differ from the CPU's by {error:.1e}"], {}


def _rows(raster: GpuRaster) -> _Result:
    """Oracle: numpy's indexing of rows, its stable sort of Morton codes, and the number of rows
    that are not finite; noise that is the same in a repetition."""
    random, problems = np.random.default_rng(5), []
    splats = SelfTestScene(name="", count=700).splats()
    cells = random.integers(0, 8, (700, 3))
    splats[0] = ((cells + 0.5) / 1023).astype(np.float32)
    rows = GpuRows(raster, splats, counters=1)
    moments = random.normal(size=(700, 4)).astype(np.float32)
    rows.write(header.MOMENT1, header.COMPONENTS["quats"], moments)
    order = rows.morton_order(np.zeros(3, np.float32), np.ones(3, np.float32))
    bits = ((axis, bit) for axis in range(3) for bit in range(3))
    codes = sum((cells[:, axis] >> bit & 1) << 3 * bit + axis for axis, bit in bits)
    if (order != np.argsort(codes, kind="stable")).any():
        problems.append("their Morton order is wrong")
    chosen = random.integers(0, 700, 900)
    fresh = random.integers(0, 2, 900).astype(np.uint8)
    rows.rebuild(chosen, fresh)
    kept = moments[chosen] * (1 - fresh[:, None])
    for table, name, expected in (
        (header.MOMENT1, "quats", kept),
        (header.VALUES, "quats", splats[1][chosen]),
        (header.VALUES, "sh0", splats[4][chosen, 0]),
    ):
        width = expected.shape[1]
        if (rows.read(table, header.COMPONENTS[name], width) != expected).any():
            problems.append(f"{name} are in wrong rows after an edit")
    moved = []
    means = np.full((900, 3), 0.5, np.float32)
    faint = np.full((900, 1), -8.0, np.float32)
    rows.write(header.VALUES, header.COMPONENTS["opacities"], faint)
    for _ in range(2):
        rows.write(header.VALUES, header.COMPONENTS["means"], means)
        rows.noise(1.0, seed=7, step=3, stream=1)
        moved.append(rows.read(header.VALUES, header.COMPONENTS["means"], 3))
    if (moved[0] != moved[1]).any() or not np.isfinite(moved[0]).all() or (moved[0] == means).all():
        problems.append("their noise is wrong")
    means[5::7, 1] = np.nan
    rows.write(header.VALUES, header.COMPONENTS["means"], means)
    lost = rows.clamp(1.0)
    clamped = rows.read(header.VALUES, header.COMPONENTS["means"], 3)
    if lost != len(means[5::7]) or not np.isfinite(clamped).all():
        problems.append("rows that are not finite are not reset")
    rows.close()
    return problems, {}

"""What programs of the tests do with the loss of a picture; each `print_` prints a line of JSON."""

import hashlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import torch

from gscore.engine.base import ShUpdate, StepPhoto, StepRequest, TermKind
from gscore.engine.cpu.loss import StepLoss
from gscore.errors import ShapeError
from gscore.raster.gpu.gpu_loss import GpuLossValues, gpu_image_loss
from gscore.raster.gpu.gpu_raster import GpuRaster
from gscore.raster.loss import image_loss
from gscore.raster.reference import image_loss_reference, unexposed_reference
from gscore.raster.reference.blur import blur_reference
from gscore.raster.training_rasterizer import Picture
from gscore.shared_constants import EXPOSURE_OFFSET
from tests.gpu.programs import _opened, _print
from tests.raster.test_loss import pictures

GAIN, FAR_GAIN = (1.3, 0.9, 0.7), (1.0, 0.05, 20.0)
"""Of pictures partly on the dark line; with the second also the background of blue."""
BACKGROUND, WHITE = (0.2, 0.5, 0.9), 255
SIZES = ((1, 1), (7, 3), (33, 17), (100, 75))
"""Width and height."""
MODES = "none", "composite", "ignore"
BLUR = (4.0, -1.5, 2.0)
BLURS = (0.0, 0.0, 0.0), (0.3, 0.1, 0.2), (2.0, -2.5, 7.0), (200.0, 90.0, 90.0), (4e3, 4e3, 4096.0)
"""None at all, less than a pixel, across, wider than the picture, and with the most taps."""


@dataclass(frozen=True)
class Case:
    """A picture, its photo, and the options of the loss."""

    size: tuple[int, int]
    mode: str = "none"
    gain: tuple[float, float, float] | None = None
    weight: float = 0.2
    blur: tuple[float, float, float] | None = None
    mask_value: int = -1
    """Of all pixels; -1: soft."""
    mask_alpha: float = 0.0
    see_through: float = 0.0
    has_mask: bool = True

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]:
        """Image, photo, mask and opacity; where the photo is white, the image is brighter."""
        image, photo, mask = pictures(*self.size[::-1])
        image *= 1.2
        photo[image > 1.1] = WHITE
        mask[image[..., 0] > 1.1] = WHITE
        if self.mask_value >= 0:
            mask[:] = self.mask_value
        alpha = torch.rand(mask.shape, generator=torch.Generator().manual_seed(1))
        return image.numpy(), photo.numpy(), mask.numpy() if self.has_mask else None, alpha.numpy()

    def counted(self) -> float:
        """Some share of unmasked pixels."""
        return 0.75 if self.mode == "ignore" else 1.0

    def found(self, raster: GpuRaster, rows_at_once: int = 0) -> GpuLossValues:
        """The device's."""
        image, photo, mask, alpha = self.arrays()
        return gpu_image_loss(
            raster,
            image,
            photo,
            ssim_weight=self.weight,
            mask=mask,
            mask_mode=self.mode,
            background=BACKGROUND,
            gain=self.gain,
            blur=self.blur,
            fixed_background=self.mode == "composite",
            alpha=alpha,
            mask_alpha=self.mask_alpha,
            see_through=self.see_through,
            counted=self.counted(),
            rows_at_once=rows_at_once,
        )


def cases() -> Iterator[Case]:
    """All sizes, modes, gains; all and no pixels masked; the ends of the weight; all terms;
    blurs."""
    for size, mode, gain in product(SIZES, MODES, (None, GAIN)):
        yield Case(size, mode, gain)
    for mode in MODES:
        yield Case((33, 17), mode, FAR_GAIN)
    for mode, gain, value in product(MODES[1:], (None, GAIN), (0, WHITE)):
        yield Case((33, 17), mode, gain, mask_value=value, mask_alpha=0.1, see_through=0.3)
    for mode, weight in product(MODES, (0.0, 1.0)):
        yield Case((33, 17), mode, GAIN, weight)
    for size, mode in product(SIZES, MODES):
        yield Case(size, mode, GAIN, mask_alpha=0.1, see_through=0.3)
    yield Case((33, 17), mask_alpha=0.1, see_through=0.3, has_mask=False)
    for size, mode, gain in product(SIZES, MODES, (None, GAIN)):
        yield Case(size, mode, gain, blur=BLUR)
    for blur, mode in product(BLURS, MODES[:2]):
        yield Case((33, 17), mode, GAIN, blur=blur, mask_alpha=0.1, see_through=0.3)


def by_cpu(case: Case) -> dict[str, Any]:
    """Loss and gradients of the CPU's engine."""
    image, photo, mask, alpha = case.arrays()
    terms = {TermKind.L1: 1 - case.weight, TermKind.SSIM: case.weight}
    terms |= {TermKind.MASK_ALPHA: case.mask_alpha, TermKind.SEE_THROUGH: case.see_through}
    view: Any = None
    request = StepRequest(
        step=1,
        photo=0,
        view=view,
        background=BACKGROUND,
        shown_background=BACKGROUND,
        gain=case.gain,
        blur=case.blur,
        sh_degree=0,
        sh_update=ShUpdate.STEP,
        rates={},
        terms=tuple(terms.items()),
        extent=1.0,
    )
    picture = Picture(torch.from_numpy(image), torch.from_numpy(alpha))
    taken = StepPhoto(image=photo, mask=mask, mask_mode=case.mode, counted=case.counted())
    found = StepLoss(1).of(picture, taken, request)
    v_alpha = np.zeros_like(alpha) if found.v_alpha is None else found.v_alpha.numpy()
    return {
        "loss": found.value,
        "mse": found.mse,
        "v_image": found.v_rgb.numpy(),
        "v_alpha": v_alpha,
        "v_log_gain": np.array(found.v_log_gain),
    }


def by_twin(case: Case) -> dict[str, Any]:
    """Loss and gradients of the reference in float64, by autograd."""
    image, photo, mask, alpha = (
        None if a is None else torch.from_numpy(a.astype(np.float64)) for a in case.arrays()
    )
    assert image is not None and photo is not None and alpha is not None
    for leaf in (image, alpha):
        leaf.requires_grad_()
    gain = torch.tensor(case.gain or GAIN).double().requires_grad_()
    shown = image
    if case.mode == "composite":  # the gain brings the colour behind the splats to the background
        color = torch.tensor(BACKGROUND, dtype=torch.float64)
        of = [unexposed_reference(color, by) for by in (gain, gain.detach())]
        shown = image + (1 - alpha.detach())[..., None] * (of[0] - of[1])
    loss, ssim = image_loss_reference(
        shown if case.blur is None else blur_reference(shown, case.blur),
        photo,
        mask=mask,
        mask_mode=case.mode,
        ssim_weight=case.weight,
        background=BACKGROUND,
        gain=gain if case.gain else None,
    )
    weights = torch.ones_like(alpha) if mask is None else mask / WHITE
    mask_alpha = (alpha - weights).abs().mean() if mask is not None else torch.zeros(())
    see_through = ((1 - alpha) * weights).mean()
    loss = loss + case.mask_alpha * mask_alpha + case.see_through * see_through
    loss.backward()
    asked = {"mask_alpha": mask_alpha, "see_through": see_through}
    in_log = gain.grad * gain.detach() if case.gain and gain.grad is not None else 0 * gain.detach()
    v_alpha = torch.zeros_like(alpha) if alpha.grad is None else alpha.grad
    assert image.grad is not None
    return {
        "loss": loss.item(),
        "ssim": ssim.item(),
        **{k: v.item() for k, v in asked.items() if getattr(case, k)},
        "v_image": image.grad.numpy(),
        "v_alpha": v_alpha.numpy(),
        "v_log_gain": in_log.numpy(),
    }


def problems_of(case: Case, found: dict[str, Any], true: dict[str, Any]) -> list[str]:
    """Values that differ by more than 1e-6 of the larger of them and 1, gradients by more than 1e-5
    of the largest and, of means over pixels, 1e-7; of sums in ln gain, 1e-5 of the sum of
    magnitudes."""
    problems = []
    for name, value in true.items():
        if name == "v_log_gain":
            largest = np.abs(case.arrays()[0]) + EXPOSURE_OFFSET
            limit = 1e-5 * float(np.abs(true["v_image"] * largest).sum())
        elif name in ("v_image", "v_alpha"):
            limit = 1e-5 * float(np.abs(value).max()) + 1e-7
        else:
            limit = 1e-6 * max(1.0, abs(value))
        error = float(np.abs(np.asarray(found[name], np.float64) - value).max())
        if not error <= limit:
            problems.append(f"{case} {name}: {error} > {limit}")
    return problems


def bits_of(found: GpuLossValues) -> str:
    """Hash of a result."""
    values = [float(v) for v in asdict(found).values() if isinstance(v, bool | float)]
    content = np.array([*values, *found.v_log_gain], np.float64).tobytes()
    return hashlib.sha256(content + found.v_image.tobytes() + found.v_alpha.tobytes()).hexdigest()


def losses(raster: GpuRaster) -> dict[str, Any]:
    """Problems of all cases by both oracles, those of a loss with another weight, and the hashes of
    each case in repeats and in submissions of one and two rows of tiles."""
    problems, noticed, bits = [], [], []
    for case in cases():
        found = case.found(raster)
        values = asdict(found)
        problems += [] if found.sane and not found.infinite else [f"{case} is not sane"]
        for true in (by_cpu(case), by_twin(case)):
            problems += problems_of(case, values, true)
        other = by_twin(replace(case, weight=abs(case.weight - 0.01)))
        nothing_counts = case.mode == "ignore" and case.mask_value == 0
        noticed.append(bool(problems_of(case, values, other)) != nothing_counts)
        again = [case.found(raster, rows) for rows in (0, 1, 2)]
        bits.append(sorted({bits_of(one) for one in (found, *again)}))
    return {"problems": problems, "noticed": noticed, "bits": bits}


def print_bits() -> None:
    """Hash of each case."""
    with _opened() as raster:
        _print([bits_of(case.found(raster)) for case in cases()])


def slopes(raster: GpuRaster) -> list[tuple[float, float]]:
    """Derivatives and central differences of the loss, in ln gain, in the opacities of two pixels,
    and in the colours of two pixels of a picture that is blurred."""
    image, photo, mask, alpha = Case((33, 17)).arrays()
    assert mask is not None
    alpha[3, 4], alpha[16, 32], mask[3, 4], mask[16, 32] = 0.9, 0.1, 90, 200
    options: dict[str, Any] = {"mask": mask, "mask_mode": "composite", "background": BACKGROUND}

    def by_gain(factors: np.ndarray) -> GpuLossValues:
        gain: Any = tuple(factors.tolist())
        return gpu_image_loss(raster, image, photo, ssim_weight=1.0, gain=gain, **options)

    def by_alpha(opacity: np.ndarray) -> GpuLossValues:
        terms = {"alpha": opacity, "mask_alpha": 20.0, "see_through": 30.0}
        return gpu_image_loss(raster, image, photo, **terms, **options)

    found = []
    for blur in (None, BLUR):
        options["blur"] = blur
        for c, unit in enumerate(np.eye(3)):
            up, down = (by_gain(np.array(GAIN) * np.exp(h * unit)).loss for h in (1e-3, -1e-3))
            found.append((by_gain(np.array(GAIN)).v_log_gain[c], (up - down) / 2e-3))
    for place in ((3, 4), (16, 32)):
        unit = np.zeros_like(alpha)
        unit[place] = 0.1
        up, down = by_alpha(alpha + unit).loss, by_alpha(alpha - unit).loss
        found.append((float(by_alpha(alpha).v_alpha[place]), (up - down) / 0.2))
    return [*found, *_slopes_of_colours(raster)]


def _slopes_of_colours(raster: GpuRaster) -> Iterator[tuple[float, float]]:
    """Derivatives and central differences of the loss in colours at a corner and inside, of a
    picture so small that they are large; blurred."""
    image, photo, _, _ = Case((7, 3)).arrays()

    def of(moved: np.ndarray) -> GpuLossValues:
        return gpu_image_loss(raster, moved, photo, ssim_weight=1.0, blur=(1.0, 0.3, 0.5))

    for place in ((0, 6, 0), (1, 4, 0)):
        unit = np.zeros_like(image)
        unit[place] = 0.01
        up, down = of(image + unit).loss, of(image - unit).loss
        yield float(of(image).v_image[place]), (up - down) / 0.02


def insane(raster: GpuRaster) -> list[list[Any]]:
    """Whether the loss is called sane, and infinite, and whether the CPU's is not finite, for
    pictures with NaN, infinities and absurd values, and before and after."""
    image, photo, mask, alpha = Case((33, 17)).arrays()
    found = []
    for value, mode in product((0.5, np.nan, np.inf, -np.inf, 1e30, 1e5, 0.5), MODES):
        damaged = image.copy()
        damaged[5, 20, 1] = value
        options: dict[str, Any] = {"mask": mask, "mask_mode": mode}
        one = gpu_image_loss(raster, damaged, photo, **options)
        options["mask"] = torch.from_numpy(mask)
        true = image_loss(torch.from_numpy(damaged), torch.from_numpy(photo), **options)
        infinite = not bool(torch.isfinite(true.loss))
        found.append([str(value), mode, one.sane, one.infinite, infinite])
    alpha[0, 0] = np.nan
    one = gpu_image_loss(raster, image, photo, alpha=alpha, see_through=0.1)
    return [*found, ["alpha", "none", one.sane, one.infinite, True]]


def identical(raster: GpuRaster) -> list[float]:
    """SSIM, L1, squares and loss of a picture that is its photo, and its largest gradient."""
    _, photo, _, _ = Case((40, 50)).arrays()
    one = gpu_image_loss(raster, photo.astype(np.float32) * np.float32(1 / WHITE), photo)
    return [one.ssim, one.l1, one.mse, one.loss, float(np.abs(one.v_image).max())]


def bright(raster: GpuRaster) -> list[float]:
    """SSIM of a white wall with little noise, and the reference's."""
    photo = np.full((64, 64, 3), 250, np.uint8)
    noise = np.random.default_rng(1).standard_normal(photo.shape)
    image = (0.98 + 0.002 * noise).astype(np.float32)
    true = image_loss_reference(torch.from_numpy(image).double(), torch.from_numpy(photo))[1]
    return [gpu_image_loss(raster, image, photo).ssim, true.item()]


def reach(raster: GpuRaster) -> list[float]:
    """Largest error, beyond a relative 1e-6, of the gradient around a dot in a flat picture, near
    corners of tiles; and the least of the reference's gradients as far away as two windows
    reach."""
    photo = np.full((40, 40, 3), 128, np.uint8)
    errors, least = [], []
    for row, column in ((15, 16), (26, 5)):
        image = photo.astype(np.float32) * np.float32(1 / WHITE)
        image[row, column] += 0.5
        exact = torch.from_numpy(image).double().requires_grad_()
        image_loss_reference(exact, torch.from_numpy(photo), ssim_weight=1.0)[0].backward()
        assert exact.grad is not None
        true = exact.grad.numpy()
        found = gpu_image_loss(raster, image, photo, ssim_weight=1.0).v_image
        errors.append(float((np.abs(found - true) - 1e-6 * np.abs(true)).max()))
        least.append(float(np.abs(true[[row - 10, row + 10], column]).min()))
        least.append(float(np.abs(true[row, column + 10]).min()))
    return [max(errors), min(least)]


def print_all() -> None:
    """All of the above by their names."""
    with _opened() as raster:
        found: dict[str, Any] = losses(raster)
        for test in (slopes, insane, identical, bright, reach):
            found[test.__name__] = test(raster)
    _print(found)


def print_refusals() -> None:
    """Messages for invalid arguments."""
    image, photo, mask, _ = Case((7, 3)).arrays()
    messages = []
    with _opened() as raster:
        for wrong in (
            {"see_through": 1.0},
            {"mask_mode": "composite"},
            {"mask_mode": "soft"},
            {"gain": (1.0, float("nan"), 1.0)},
            {"ssim_weight": 2.0},
            {"rows_at_once": -1},
            {"blur": (1.0, 2.0, 1.0)},
            {"target": photo[:2]},
            {"mask": mask[:, :2] if mask is not None else None, "mask_mode": "ignore"},
        ):
            given: dict[str, Any] = {"image": image, "target": photo} | wrong
            try:
                gpu_image_loss(raster, **given)
                messages.append("")
            except ShapeError as error:
                messages.append(str(error))
    _print(messages)

"""Oracle: the loss written out in float64 torch with autograd; and values known by hand."""

import pytest
import torch

from gscore.errors import ShapeError
from gscore.raster.loss import image_loss, image_loss_gradient
from gscore.raster.reference import image_loss_reference
from gscore.shared_constants import EXPOSURE_OFFSET

BACKGROUND = (0.2, 0.5, 0.9)


def twin(
    image: torch.Tensor, target: torch.Tensor, mask: torch.Tensor, mode: str, weight: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Loss and SSIM of [H, W, 3] float64 by the reference."""
    return image_loss_reference(
        image, target, mask=mask, mask_mode=mode, ssim_weight=weight, background=BACKGROUND
    )


def pictures(height: int, width: int, seed: int = 0) -> tuple[torch.Tensor, ...]:
    """A smooth picture plus noise, a photo like it, and a soft mask."""
    g = torch.Generator().manual_seed(seed)
    y, x = torch.meshgrid(torch.linspace(0, 3, height), torch.linspace(0, 4, width), indexing="ij")
    smooth = torch.stack([(x * k + y).sin() * 0.4 + 0.5 for k in (1, 2, 3)], dim=-1)
    image = smooth + 0.1 * torch.randn(height, width, 3, generator=g)
    photo = (smooth + 0.05 * torch.randn(height, width, 3, generator=g)).clamp(0, 1)
    mask = (torch.rand(height, width, generator=g) * 255).byte()
    return image, (photo * 255).byte(), mask


@pytest.mark.parametrize("mode", ["none", "composite", "ignore"])
@pytest.mark.parametrize(
    "size",
    [(1, 1), (8, 8), (11, 5), (33, 47), (130, 96), (65, 17), (12, 530), (23, 1030), (389, 7)],
)
def test_value_and_gradient(isa: str, size: tuple[int, int], mode: str) -> None:
    """Oracle: `twin`; values to 1e-6, gradients to 1e-5 of the largest; means over pixels."""
    image, target, mask = pictures(*size)
    exact = image.double().requires_grad_()
    loss, ssim = twin(exact, target, mask, mode, 0.2)
    loss.backward()
    image.requires_grad_()
    found = image_loss(
        image, target, mask=mask, mask_mode=mode, background=BACKGROUND, ssim_weight=0.2
    )
    found.loss.backward()
    assert found.loss.item() == pytest.approx(loss.item(), abs=1e-6)
    assert found.ssim == pytest.approx(ssim.item(), abs=1e-6)
    m = mask.double()[..., None] / 255 if mode != "none" else 1.0
    shown, photo = exact.detach(), target.double() / 255 * m
    if mode == "composite":
        photo = photo + torch.tensor(BACKGROUND).double() * (1 - m)
    elif mode == "ignore":
        shown = shown * m
    assert found.l1 == pytest.approx((shown - photo).abs().mean().item(), abs=1e-6)
    assert found.mse == pytest.approx(((shown - photo) ** 2).mean().item(), abs=1e-6)
    assert exact.grad is not None and image.grad is not None
    largest = exact.grad.abs().max()
    assert largest > 0
    assert (image.grad - exact.grad).abs().max() < 1e-5 * largest + 1e-7


def test_a_dot_teaches_as_far_as_two_windows_reach(isa: str) -> None:
    """Oracle: `twin`, of a dot in a flat picture ten pixels on either side of a tile border: a
    millionth reaches across, which is lost in other pictures."""
    for row, column in ((10, 255), (29, 274)):
        target = torch.full((40, 530, 3), 128, dtype=torch.uint8)
        image = target.float() * (1 / 255)
        image[row, column] += 0.5
        exact = image.double().requires_grad_()
        twin(exact, target, torch.zeros(40, 530), "none", 1.0)[0].backward()
        image.requires_grad_()
        image_loss(image, target, ssim_weight=1.0).loss.backward()
        assert exact.grad is not None and image.grad is not None
        beyond = exact.grad[row, 265 if column < 265 else 264]
        below = exact.grad[20 if row < 20 else 19, column]
        assert min(beyond.abs().min(), below.abs().min()) > 2e-9
        assert (image.grad - exact.grad).abs().max() < 1e-10


def test_bright_flat_pictures_keep_their_digits(isa: str) -> None:
    """Oracle: `twin`. E[x^2] - E[x]^2 of white walls would cancel without the shift."""
    g = torch.Generator().manual_seed(1)
    target = torch.full((64, 64, 3), 250, dtype=torch.uint8)
    image = 0.98 + 0.002 * torch.randn(64, 64, 3, generator=g)
    found = image_loss(image, target)
    _, ssim = twin(image.double(), target, torch.zeros(64, 64), "none", 0.2)
    assert found.ssim == pytest.approx(ssim.item(), abs=2e-6)


def test_identical_pictures_score_exactly_one(isa: str) -> None:
    """Oracle: the definition."""
    _, target, _ = pictures(40, 50)
    image = (target.float() * (1 / 255)).requires_grad_()
    found = image_loss(image, target)
    assert (found.ssim, found.l1, found.mse, found.loss.item()) == (1.0, 0.0, 0.0, 0.0)
    found.loss.backward()
    assert image.grad is not None and image.grad.abs().max() < 1e-9


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_weights_at_the_ends(weight: float) -> None:
    """Oracle: L1 alone and 1 - SSIM alone."""
    image, target, mask = pictures(30, 30)
    loss, _ = twin(image.double(), target, mask, "none", weight)
    assert image_loss(image, target, ssim_weight=weight).loss.item() == pytest.approx(
        loss.item(), abs=1e-6
    )


def test_bits_do_not_depend_on_threads() -> None:
    """Oracle: one thread."""
    image, target, mask = pictures(300, 70)

    def run(threads: int) -> tuple[float, torch.Tensor]:
        x = image.clone().requires_grad_()
        found = image_loss(x, target, mask=mask, mask_mode="ignore", threads=threads)
        found.loss.backward()
        assert x.grad is not None
        return found.ssim, x.grad

    one = run(1)
    for threads in (2, 3, 8):
        many = run(threads)
        assert many[0] == one[0]
        assert torch.equal(many[1], one[1])


def test_gradient_scales_with_what_follows() -> None:
    """Oracle: the chain rule."""
    image, target, _ = pictures(20, 20)
    a, b = image.clone().requires_grad_(), image.clone().requires_grad_()
    image_loss(a, target).loss.backward()
    (3 * image_loss(b, target).loss).backward()
    assert a.grad is not None and b.grad is not None
    torch.testing.assert_close(b.grad, 3 * a.grad)


def test_bad_input_is_named() -> None:
    """Oracle: the messages."""
    image, target, mask = pictures(9, 7)
    with pytest.raises(ShapeError, match=r"target must be \[9, 7, 3\] uint8"):
        image_loss(image, target[:5])
    with pytest.raises(ShapeError, match="mask must be"):
        image_loss(image, target, mask=mask[:5], mask_mode="ignore")
    with pytest.raises(ShapeError, match=r"mask must be .* got none"):
        image_loss(image, target, mask_mode="composite")
    with pytest.raises(ShapeError, match="mask_mode must be one of"):
        image_loss(image, target, mask=mask, mask_mode="soft")
    with pytest.raises(ShapeError, match="ssim_weight must be 0 to 1"):
        image_loss(image, target, ssim_weight=2)


@pytest.mark.parametrize("mode", ["none", "composite", "ignore"])
@pytest.mark.parametrize("size", [(1, 1), (33, 47), (23, 1030), (389, 7)])
@pytest.mark.parametrize("gains", [(1.3, 0.9, 0.7), (1.0, 0.05, 20.0)])
def test_a_gain_and_what_it_learns(
    isa: str, gains: tuple[float, float, float], size: tuple[int, int], mode: str
) -> None:
    """Oracle: `image_loss_reference` with the gain as a leaf, in pictures with parts below zero, in
    the dark, and white in the photo and brighter than that; gradients to 1e-5 of the largest, those
    in ln gain by the chain rule."""
    image, target, mask = pictures(*size)
    image = image * 1.2
    target[image > 1.1] = 255
    mask[image[..., 0] > 1.1] = 255
    gain = torch.tensor(gains)
    exact, by = image.double().requires_grad_(), gain.double().requires_grad_()
    loss, _ = image_loss_reference(
        exact, target, mask=mask, mask_mode=mode, background=BACKGROUND, gain=by
    )
    loss.backward()
    v_image = torch.full_like(image, torch.nan)
    found = image_loss_gradient(
        image, target, v_image, mask=mask, mask_mode=mode, background=BACKGROUND, gain=gain
    )
    assert exact.grad is not None and by.grad is not None
    assert found.loss == pytest.approx(loss.item(), abs=1e-6)
    assert (v_image - exact.grad).abs().max() < 1e-5 * exact.grad.abs().max() + 1e-7
    in_log = by.grad * by.detach()
    terms = exact.grad * (exact.detach().abs() + EXPOSURE_OFFSET)
    scale = terms.abs().sum().item()
    assert torch.tensor(found.v_log_gain).double() == pytest.approx(in_log, abs=1e-5 * scale)
    if size == (33, 47) and mode != "composite":
        assert (v_image == 0).any(), "nothing was white and brighter than that"


def test_a_gain_of_one_changes_nothing(isa: str) -> None:
    """Oracle: the loss without one, of a picture that is nowhere brighter than white."""
    image, target, _ = pictures(70, 90)
    image = image.clamp(0, 0.99)
    one, none = torch.empty_like(image), torch.empty_like(image)
    found = image_loss_gradient(image, target, one, gain=torch.ones(3))
    plain = image_loss_gradient(image, target, none)
    assert found.loss == pytest.approx(plain.loss, abs=1e-7)
    torch.testing.assert_close(one, none, rtol=1e-5, atol=1e-10)
    assert plain.v_log_gain == (0.0, 0.0, 0.0)


def test_bits_of_a_gain_do_not_depend_on_threads() -> None:
    """Oracle: one thread."""
    image, target, _ = pictures(390, 600)
    gain, v_image = torch.tensor([1.1, 0.9, 1.0]), torch.empty_like(image)
    one = image_loss_gradient(image, target, v_image, gain=gain, threads=1)
    for threads in (2, 3, 8):
        many = torch.empty_like(image)
        assert image_loss_gradient(image, target, many, gain=gain, threads=threads) == one
        assert torch.equal(many, v_image)


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
def test_a_gain_that_is_none_is_named(bad: float) -> None:
    """Oracle: the message."""
    image, target, _ = pictures(9, 7)
    with pytest.raises(ShapeError, match="gain must be above 0"):
        image_loss_gradient(image, target, image.clone(), gain=torch.tensor([1.0, bad, 1.0]))

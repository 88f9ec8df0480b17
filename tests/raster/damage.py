"""Check of the gradients of a scene with a damaged row."""

import torch
from torch import Tensor

from gscore.splats import PARAMETERS


def assert_row_without_gradient(
    damaged: dict[str, Tensor], whole: dict[str, Tensor], row: int, name: str
) -> None:
    """Check for no gradient of the damaged row; all others and the camera equal, bit for bit, those
    of `whole`, the scene without that row."""
    others = torch.arange(len(damaged["means"])) != row
    for field in PARAMETERS:
        assert torch.equal(damaged[field].grad[others], whole[field].grad), (name, field)
        assert not damaged[field].grad[row].any(), (name, field)
    assert torch.equal(damaged["viewmat"].grad, whole["viewmat"].grad), name

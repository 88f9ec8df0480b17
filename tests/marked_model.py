"""A model in which every number encodes its row."""

from collections.abc import Callable

import pytest
import torch

from gscore.engine.cpu.model import CpuModel


@pytest.fixture
def marked_model() -> Callable[..., CpuModel]:
    """`make(n)`: a model of n rows in which every number encodes its row.

    Parameters are the row, first moments 1000 + row, second moments 2000 + row, and the counter
    `seen` 3000 + row, so that a misplaced row shows.
    """

    def make(n: int, *, sh_rest: int = 3) -> CpuModel:
        row = torch.arange(n, dtype=torch.float32)
        model = CpuModel(
            {
                "means": row[:, None].repeat(1, 3),
                "quats": row[:, None].repeat(1, 4) + 1,
                "scales": row[:, None].repeat(1, 3) * 0.01 - 3,
                "opacities": row * 0.1 - 1,
                "sh0": row[:, None, None].repeat(1, 1, 3),
                "shN": row[:, None, None].repeat(1, sh_rest, 3),
            },
            counters=("grad2d", "views"),
        )
        for name, p in model.params.items():
            shape = [n] + [1] * (p.ndim - 1)
            first = (1000 + row).reshape(shape).expand(p.shape).clone()
            model.replace(name, p, first, first + 1000, steps=7)
        model.rows["views"] = 3000 + row
        return model

    return make

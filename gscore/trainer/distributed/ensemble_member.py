"""Ensemble member: one of the models trained in parallel, with its checkpoint state."""

import re
from collections.abc import Mapping
from typing import Any

import torch

from ...engine.cpu.model import CpuModel, Moments
from ..model.checkpoint_schema import as_int, check_tensors
from .batch_gradients import BatchGradients, accumulated_of
from .process_group import ProcessGroup

_PLACE = re.compile(r"([1-9])/")
"""Prefix of the names of all models but the first in a checkpoint."""


class EnsembleMember:
    """One model of an ensemble with the state of its steps; a single model is a sole member."""

    def __init__(self, place: int, model: CpuModel, team: ProcessGroup | None) -> None:
        """`place` is its index in the ensemble, from 0; `team` is the process group."""
        self.place = place
        self.model = model
        self.batch = BatchGradients(team) if team else None
        """Gradients of a batch; None: one process."""
        self.pruned = 0
        """Splats removed so far for their low contribution."""

    def of(self, stored: Mapping[str, Any]) -> dict[str, Any]:
        """This member's entries of the tensors, or of the state, of a checkpoint."""
        if self.place == 0:
            return {key: value for key, value in stored.items() if _PLACE.match(key) is None}
        name = self._name("")
        found = {key: value for key, value in stored.items() if key.startswith(name)}
        return {key.removeprefix(name): value for key, value in found.items()}

    def state(self) -> dict[str, Any]:
        """State other than tensors, as JSON values."""
        model = self.model
        found = {
            "adam_steps": {name: model.steps(name) for name in model.params},
            "pruned": self.pruned,
        }
        return {self._name(key): value for key, value in found.items()}

    def tensors(self) -> dict[str, torch.Tensor]:
        """All tensors that its next step depends on, by name; no copies."""
        model, out = self.model, {}
        for name, p in model.params.items():
            moment1, moment2 = model.moments(name)
            out |= {f"param/{name}": p, f"m1/{name}": moment1, f"m2/{name}": moment2}
        out |= {"gathered/shN": model.grads["shN"], "drift": model.drift}
        out |= self.batch.tensors() if self.batch else {}
        out |= {f"row/{name}": counter for name, counter in model.rows.items()}
        return {self._name(key): tensor for key, tensor in out.items()}

    def check(self, tensors: Mapping[str, torch.Tensor], like: CpuModel) -> None:
        """Raise ValueError or KeyError unless its checkpoint tensors fit each other and `like`."""
        check_tensors(self.of(tensors), like)

    def restore(
        self,
        state: Mapping[str, Any],
        tensors: Mapping[str, torch.Tensor],
        *,
        rank: int = 0,
        size: int = 1,
    ) -> None:
        """Restore this member from `state` and `tensors` of a checkpoint, as one of `size` ranks;
        takes ownership of the tensors.

        Raises:
            ValueError, KeyError: `state` or `tensors` are invalid.
        """
        mine, stated = self.of(tensors), self.of(state)
        steps = stated["adam_steps"]
        self.pruned = as_int("pruned", stated["pruned"])
        gathered = accumulated_of(mine, rank, size)
        names = list(self.model.params)
        moments = {
            name: Moments(
                mine[f"m1/{name}"],
                mine[f"m2/{name}"],
                as_int(f"adam_steps of {name}", steps[name]),
                gathered if name == "shN" else None,
            )
            for name in names
        }
        if self.batch:
            self.batch.forget()
        self.model = CpuModel({name: mine[f"param/{name}"] for name in names}, moments)
        self.model.rows = {k.removeprefix("row/"): t for k, t in mine.items() if k[:4] == "row/"}
        self.model.drift = mine["drift"]

    def _name(self, key: str) -> str:
        return f"{self.place}/{key}" if self.place else key


def count_members(tensors: Mapping[str, Any]) -> int:
    """Number of models in the tensors of a checkpoint."""
    return 1 + max((int(found[1]) for key in tensors if (found := _PLACE.match(key))), default=0)

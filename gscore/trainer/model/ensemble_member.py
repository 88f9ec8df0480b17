"""Ensemble member: one of the models trained in parallel, with its checkpoint state."""

import re
from collections.abc import Mapping
from typing import Any

import torch

from ...engine.base import Engine, EngineModel
from .checkpoint_schema import as_int, check_tensors

_PLACE = re.compile(r"([1-9])/")
"""Prefix of the names of all models but the first in a checkpoint."""


class EnsembleMember:
    """One model of an ensemble with the state of its steps; a single model is a sole member."""

    def __init__(self, place: int, model: EngineModel) -> None:
        """`place` is its index in the ensemble, from 0."""
        self.place = place
        self.model = model
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
        found = {"adam_steps": dict(self.model.adam_steps), "pruned": self.pruned}
        return {self._name(key): value for key, value in found.items()}

    def tensors(self) -> dict[str, torch.Tensor]:
        """All tensors that its next step depends on, by name; no copies."""
        saved = self.model.save().items()
        return {self._name(key): torch.from_numpy(array) for key, array in saved}

    def check(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Raise ValueError or KeyError unless its checkpoint tensors fit each other and its
        model."""
        check_tensors(self.of(tensors), self.model.save())

    def restore(
        self, engine: Engine[Any], state: Mapping[str, Any], tensors: Mapping[str, torch.Tensor]
    ) -> None:
        """Restore this member from `state` and `tensors` of a checkpoint; takes ownership of the
        tensors.

        Raises:
            ValueError, KeyError: `state` or `tensors` are invalid.
        """
        mine, stated = self.of(tensors), self.of(state)
        self.pruned = as_int("pruned", stated["pruned"])
        steps = {
            name: as_int(f"adam_steps of {name}", stated["adam_steps"][name])
            for name in self.model.adam_steps
        }
        saved = {
            name: tensor.numpy()
            for name, tensor in mine.items()
            if name.split("/")[0] in ("param", "m1", "m2", "row", "gathered", "drift")
        }
        self.model = engine.load(saved, steps, self.model)

    def _name(self, key: str) -> str:
        return f"{self.place}/{key}" if self.place else key


def count_members(tensors: Mapping[str, Any]) -> int:
    """Number of models in the tensors of a checkpoint."""
    return 1 + max((int(found[1]) for key in tensors if (found := _PLACE.match(key))), default=0)

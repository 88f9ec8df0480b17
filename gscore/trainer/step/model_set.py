"""Model set: the models in training, one or an ensemble, with the frozen splats around them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import torch

from ...engine.base import Columns, Engine, EngineModel
from ...engine.ensemble import divide_opacities, merge_models
from ...formats.joined import joined
from ...splats import PARAMETERS, Splats
from ...transforms import Similarity
from ..model.ensemble_member import EnsembleMember
from ..region.frozen_splats import FrozenSplats
from .step_queue import engine_errors

_ROWS_A_PART = 1 << 16
"""Splats per part of `parts`."""


class ModelSet:
    """Models of one engine that start from the same splats, in the training frame."""

    def __init__(
        self,
        engine: Engine[Any],
        similarity: Similarity,
        first: Splats,
        *,
        count: int,
        counters: Sequence[str],
        frozen: FrozenSplats | None,
    ) -> None:
        """Create `count` models, each with a copy of the splats `first` and these counters.

        Args:
            engine: Owns the models.
            similarity: From COLMAP's world to the training frame.
            first: Start splats, training frame.
            count: Number of models.
            counters: Names of the strategy's counters.
            frozen: Splats that are drawn but not trained; None: none.
        """
        self._engine = engine
        self._similarity = similarity
        self.frozen = frozen
        columns = None if frozen is None else frozen.columns
        self.members = [
            EnsembleMember(
                place,
                engine.model(
                    {name: getattr(first, name).copy() for name in PARAMETERS},
                    counters=counters,
                    frozen=columns,
                ),
            )
            for place in range(count)
        ]

    @property
    def first(self) -> EngineModel:
        """The first model."""
        return self.members[0].model

    @property
    def models(self) -> list[EngineModel]:
        """All models."""
        return [member.model for member in self.members]

    @property
    def trained_count(self) -> int:
        """Number of trained splats."""
        return sum(map(len, self.models))

    @property
    def frozen_count(self) -> int:
        """Number of frozen splats."""
        return 0 if self.frozen is None else len(self.frozen)

    def widen_sh(self, degree: int) -> None:
        """Extend the SH coefficients of all models to at least `degree`."""
        for model in self.models:
            if model.sh_degree < degree:
                with engine_errors(self._engine, f"while it widened the SH degree to {degree}"):
                    self._engine.release()
                    model.widen_sh(degree)

    def splats(self) -> Splats:
        """Return the current splats in COLMAP world units; frozen ones first."""
        return self._whole({name: p.copy() for name, p in self._merged().items()})

    def parts(self) -> Iterator[Splats]:
        """Yield the rows of `splats` in parts, which are valid until the next step."""
        if self.frozen is not None:
            yield from self.frozen.parts(_ROWS_A_PART, self.first.sh_degree)
        for model in self.models:
            for at in range(0, len(model), _ROWS_A_PART):
                part = dict(model.part(at, at + _ROWS_A_PART))
                part["opacities"] = divide_opacities(part["opacities"], len(self.members))
                yield self.in_world(part)

    def finish(self) -> Splats:
        """Return the final splats: as `splats`, but without copying a single model, and the memory
        of steps is freed."""
        self._engine.release()
        for model in self.models:
            model.finish()
        return self._whole(self._merged())

    def drop_moments(self) -> None:
        """Free the state that `restore` replaces; only `restore` may be called next."""
        self._engine.release()
        for model in self.models:
            model.drop_moments()

    def state(self) -> dict[str, Any]:
        """State other than tensors, as JSON values."""
        return {key: value for member in self.members for key, value in member.state().items()}

    def tensors(self) -> dict[str, torch.Tensor]:
        """All tensors that the next step depends on, by name; no copies."""
        with engine_errors(self._engine, "while its state was read"):
            return {k: value for member in self.members for k, value in member.tensors().items()}

    def checked(self, tensors: Mapping[str, torch.Tensor], count: int) -> list[EnsembleMember]:
        """Return `count` members for `restore`; ValueError or KeyError unless `tensors` of a
        checkpoint fit each other and them."""
        members = [EnsembleMember(place, self.first) for place in range(count)]
        for member in members:
            member.check(tensors)
        if len({member.of(tensors)["param/shN"].shape[1] for member in members}) > 1:
            raise ValueError("its models have different SH degrees")
        return members

    def restore(
        self,
        members: list[EnsembleMember],
        state: Mapping[str, Any],
        tensors: Mapping[str, torch.Tensor],
    ) -> None:
        """Restore the members that `checked` returned, and take ownership of the tensors.

        Raises:
            ValueError, KeyError: `state` or `tensors` are invalid.
        """
        self._engine.release()
        self.members = members
        for member in members:
            member.restore(self._engine, state, tensors)

    def in_world(self, params: Columns) -> Splats:
        """Raw parameters as splats in COLMAP world units."""
        return self._similarity.splats_from_training(Splats(**params))

    def _merged(self) -> Columns:
        return merge_models([model.part(0, len(model)) for model in self.models])

    def _whole(self, params: Columns) -> Splats:
        """Frozen splats followed by the trained ones, COLMAP world."""
        trained = self.in_world(params)
        return trained if self.frozen is None else joined([self.frozen.world, trained])

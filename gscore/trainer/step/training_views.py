"""Training views of a step: cameras, photos and backgrounds."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import torch

from ...config import Background, TrainConfig
from ...engine.base import Color
from ...engine.random import uniform
from ...errors import GsError
from ...raster.request import Frustum
from ..distributed import batch_losses
from ..distributed.process_group import ProcessGroup
from ..model.checkpoint_schema import as_float, as_int, as_int_list, as_measurements
from ..photos.image_pyramid import AHEAD, SizedView
from ..photos.view_sampler import ViewSampler
from ..schedule.plan import Plan
from ..views.model_renderer import COLORS, ModelRenderer
from ..views.photo_parameters import PhotoParameters


class TrainingView(NamedTuple):
    """The view of a step for one model."""

    indices: list[int]
    """Views of the batch, one for each rank."""
    index: int
    """This rank's view."""
    sized: SizedView
    """This rank's view with its photo."""
    background: Color
    gain: Color | None
    """Gain of its photo; None: no gains."""
    factor: float
    """Divisor of the photos' sides."""

    @property
    def view(self) -> Frustum:
        """This rank's view."""
        return self.sized.view


class ViewBatcher:
    """Batches of training views for each step, different ones for each model."""

    def __init__(
        self,
        config: TrainConfig,
        sampler: ViewSampler,
        renderer: ModelRenderer,
        photo_parameters: PhotoParameters,
        generator: torch.Generator,
        *,
        group: ProcessGroup | None,
    ) -> None:
        """Views come from `renderer` in the order of `sampler`, which `generator` shuffles."""
        self._sampler = sampler
        self._renderer = renderer
        self._photo_parameters = photo_parameters
        self._generator = generator
        self._group = group
        self._background = config.background
        if self._background is Background.AUTO:
            composite = renderer.photos.mask_mode == "composite"
            self._background = Background.RANDOM if composite else Background.BLACK
        self._costs: dict[int, float] = {}
        """Last rendering cost of each view in a process group; equal on all ranks."""
        self.factor = math.inf
        """Divisor of the photos' sides in the last step."""

    def draw(self, plan: Plan, step: int, *, photos: int, models: int) -> list[TrainingView]:
        """Draw the batch of `photos` for a step, and return this rank's view for each model.

        Raises:
            DatasetError, FormatError: a photo cannot be read; the views go back to the sampler.
        """
        batches = self._next_views(photos, models)
        # A rank without a view in a batch renders another rank's view and discards the result.
        place = min(self._group.rank, photos - 1) if self._group else 0
        # An extended run does not return to smaller photos.
        self.factor = min(self.factor, plan.factor_at(step))
        try:
            found = [
                self._renderer.sized(indices[place], self.factor, upcoming=self._upcoming(models))
                for indices in batches
            ]
        except GsError as error:  # a checkpoint stays resumable
            self.put_back(photos)
            if self._group:
                batch_losses.fail(self._group, error)
            raise
        return [
            TrainingView(
                indices=indices,
                index=indices[place],
                sized=sized,
                background=[self._step_background() for _ in range(photos)][place],
                gain=self._photo_parameters.gain_of(indices[place]),
                factor=self.factor,
            )
            for indices, sized in zip(batches, found, strict=True)
        ]

    @property
    def indices(self) -> list[int]:
        """All training views."""
        return self._sampler.indices

    def put_back(self, count: int) -> None:
        """Return the last views to the sampler."""
        self._sampler.put_back(count)

    def note_costs(self, indices: list[int], costs: Sequence[float]) -> None:
        """Record rendering costs of views, for the load balance of batches."""
        self._costs.update(zip(indices, costs, strict=True))

    def training_views(self) -> Iterator[SizedView]:
        """All training views at the size of the last step."""
        indices = self._sampler.indices
        for i, index in enumerate(indices):
            yield self._renderer.sized(index, self.factor, upcoming=indices[i + 1 :])

    def state(self) -> dict[str, Any]:
        """State for `restore`, as JSON values."""
        return {
            "order": self._sampler.order,
            "position": self._sampler.position,
            "costs": sorted(self._costs.items()),
            "factor": self.factor if math.isfinite(self.factor) else None,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the values of `state`.

        Raises:
            ValueError, KeyError: they are invalid.
        """
        factor, sampler = state.get("factor"), self._sampler
        self.factor = math.inf if factor is None else as_float("factor", factor, low=1)
        sampler.order = as_int_list("order", state["order"], set(sampler.indices))
        sampler.position = as_int("position", state["position"], high=len(state["order"]))
        self._costs = dict(as_measurements("costs", state.get("costs", [])))

    def _next_views(self, count: int, models: int) -> list[list[int]]:
        """Views of a batch for each model; in a process group, photos of similar cost."""
        rows, sampler = [], self._sampler
        for missing in range(count, 0, -1):
            if self._group and sampler.through:
                sampler.begin(self._generator)
                size = self._group.size
                sampler.order = batches_of_equal_cost(
                    sampler.order, self._costs, size, first=missing % size
                )
            sampler.next(self._generator)
            rows.append(sampler.batch_neighbours(models))
        return [list(views) for views in zip(*rows, strict=True)]

    def _upcoming(self, models: int) -> Iterator[int]:
        """Next views of this rank, as far as the order is known."""
        rank, size = (self._group.rank, self._group.size) if self._group else (0, 1)
        batches = self._sampler.upcoming(AHEAD * size, models)[rank::size]
        yield from (view for views in batches for view in views)

    def _step_background(self) -> Color:
        if self._background is Background.RANDOM:
            r, g, b = uniform(3, self._generator).tolist()
            return (r, g, b)
        return COLORS[self._background]


_BATCHES = 8
"""Most batches that are sorted together, at most a third of an epoch: their photos are random, so
that the same photos do not always share a batch."""


def batches_of_equal_cost(
    order: Sequence[int], costs: Mapping[int, float], size: int, *, first: int = 0
) -> list[int]:
    """Reorder the photos of an epoch so that those of a batch have similar costs.

    Sorts a few batches at a time, so that the composition and order of batches stay random.

    Args:
        order: Photos in random order.
        costs: Last rendering cost of each photo; if one is missing, the order stays.
        size: Photos of a batch.
        first: Number of photos that complete the current batch; they stay first.
    """
    if any(photo not in costs for photo in order):
        return list(order)
    place = {photo: k for k, photo in enumerate(order)}
    dealt, rest = list(order[:first]), order[first:]
    width = size * max(1, min(_BATCHES, len(rest) // (3 * size)))
    for begin in range(0, len(rest), width):
        some = sorted(rest[begin : begin + width], key=costs.__getitem__)
        parts = (some[k : k + size] for k in range(0, len(some), size))
        batches = [sorted(part, key=place.__getitem__) for part in parts]
        whole = [batch for batch in batches if len(batch) == size]
        whole.sort(key=lambda batch: place[batch[0]])
        for batch in (*whole, *batches[len(whole) :]):
            dealt += batch
    return dealt

"""Photo comparison: blur and transients of the training photos, measured with the models."""

from collections.abc import Callable, Generator, Iterator, Sequence
from typing import TypeVar

from ..views.model_renderer import ModelRenderer
from ..views.photo_parameters import PhotoParameters

Measured = TypeVar("Measured")


class PhotoComparison:
    """Compares the training photos with renders of the models between two steps."""

    def __init__(
        self, renderer: ModelRenderer, photo_parameters: PhotoParameters, train: Sequence[int]
    ) -> None:
        """`train`: indices of the training photos."""
        self._renderer = renderer
        self._parameters = photo_parameters
        self._train = train

    def due(self, planned: Sequence[int], step: int) -> bool:
        """Return whether to compare after `step`, by the steps that are planned for that."""
        parts = self._parameters.transients, self._parameters.blurs
        return any(part is not None and part.due(planned, step) for part in parts)

    def run(self, planned: Sequence[int], step: int, factor: float) -> Iterator[None]:
        """Measure what is due after `step`: transients, then blur; each is kept once it is measured
        for all photos.

        Args:
            planned: Steps that are planned for comparisons.
            step: Steps taken.
            factor: Divisor of the sides of the photos.

        Yields:
            None, after each photo.
        """
        blurs, transients = self._parameters.blurs, self._parameters.transients
        if transients is not None and transients.due(planned, step):
            # First, since a blur is that of what remains.
            transients.note((yield from self._measured(self._renderer.residual, factor)), step)
        if blurs is not None and blurs.due(planned, step):
            blurs.note((yield from self._measured(self._renderer.photo_blur, factor)), step)

    def _measured(
        self, measure: Callable[..., Measured], factor: float
    ) -> Generator[None, None, dict[int, Measured]]:
        """Measure all photos, one at a time; returns the results by photo."""
        found = {}
        for count, index in enumerate(self._train, 1):
            found[index] = measure(index, factor, upcoming=self._train[count:])
            yield
        return found

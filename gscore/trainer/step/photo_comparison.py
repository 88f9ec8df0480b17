"""Photo comparison: blur and transients of the training photos, measured with the models."""

from collections.abc import Iterator, Sequence

from ..views.model_renderer import ModelRenderer
from ..views.photo_parameters import PhotoParameters


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
        train, renderer = self._train, self._renderer
        if transients is not None and transients.due(planned, step):
            # First, since a blur is that of what remains.
            residuals = {}
            for count, index in enumerate(train, 1):
                residuals[index] = renderer.residual(index, factor, upcoming=train[count:])
                yield
            transients.note(residuals, step)
        if blurs is not None and blurs.due(planned, step):
            fits = {}
            for count, index in enumerate(train, 1):
                fits[index] = renderer.photo_blur(index, factor, upcoming=train[count:])
                yield
            blurs.note(fits, step)

"""Progress of the trainings of a bench, for the terminal."""

from ...text_format import number
from ..terminal.status import Status


class Ticker:
    """Progress of a training on a status line."""

    def __init__(self, capture: str, status: Status) -> None:
        self._capture, self._status = capture, status

    def __call__(self, label: str, seed: int, step: int, iterations: int) -> None:
        """Show that a step of the training with this label and seed is done."""
        which = f"{self._capture}, {label}, seed {seed}"
        far = f"step {number(step)} of {number(iterations)}"
        self._status.show([which, far], share=step / iterations)
        if step == iterations:
            self._status.clear()

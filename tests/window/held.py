"""Functions that wait until a test lets them go."""

import threading
from typing import Any


class Held:
    """A function that waits in its thread until it is let go."""

    def __init__(self, module: Any, name: str) -> None:
        self.began, self._go_on = threading.Event(), threading.Event()
        self._module, self._name, self._function = module, name, getattr(module, name)
        setattr(module, name, self._call)

    def _call(self, *args: Any, **options: Any) -> Any:
        self.began.set()
        assert self._go_on.wait(60)
        return self._function(*args, **options)

    def let_go(self) -> None:
        """Go on, and be as before."""
        self._go_on.set()
        setattr(self._module, self._name, self._function)

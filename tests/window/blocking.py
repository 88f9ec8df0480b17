"""Functions that block until a test releases them."""

import threading
from typing import Any


class Held:
    """A function that blocks in its thread until it is released."""

    def __init__(self, module: Any, name: str) -> None:
        self.began, self._go_on = threading.Event(), threading.Event()
        self._module, self._name, self._function = module, name, getattr(module, name)
        setattr(module, name, self._call)

    def _call(self, *args: Any, **options: Any) -> Any:
        self.began.set()
        assert self._go_on.wait(60)
        return self._function(*args, **options)

    def let_go(self) -> None:
        """Release it, and restore the original function."""
        self._go_on.set()
        setattr(self._module, self._name, self._function)

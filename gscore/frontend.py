"""Front-end interface in addition to `gscore`: events, runs, inspection, COLMAP, estimates.

The Blender add-on uses only these names. The stub `frontend.pyi` lists them; a name is loaded on
first use.
"""

from typing import Any

from .extras import stub_name


def __getattr__(name: str) -> Any:
    return stub_name(__name__, name)


def __dir__() -> list[str]:
    return __getattr__("__all__")

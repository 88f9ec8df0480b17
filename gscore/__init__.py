"""3D Gaussian Splatting that trains and renders on CPUs and graphics cards.

`__all__` is the interface of scripts, `gscore.frontend` the additional one of front ends. The stub
`__init__.pyi` lists the names. Both load a name on first use: importing gscore takes a few
milliseconds and loads neither torch nor the native library.
"""

from ._version import __version__ as __version__

TYPE_CHECKING = False  # type checkers know the name; importing typing takes milliseconds
if TYPE_CHECKING:
    from typing import Any


def __getattr__(name: str) -> "Any":
    from .extras import stub_name

    return stub_name(__name__, name)


def __dir__() -> list[str]:
    return __getattr__("__all__")

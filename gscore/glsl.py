"""GLSL macros of the shared constants."""

import re

from . import shared_constants


def glsl_defines(source: str) -> dict[str, str]:
    """Values of the macros GS_... in a shader: `shared_constants` as literals, lists by commas.

    Raises:
        AttributeError: a macro is not a shared constant.
    """
    names = sorted(set(re.findall(r"\bGS_(\w+)", source)))
    return {f"GS_{name}": repr(getattr(shared_constants, name)).strip("()") for name in names}

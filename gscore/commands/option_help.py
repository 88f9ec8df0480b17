"""Help texts of options, read from the docstrings of the config's fields: they stand there once."""

import ast
import inspect
import re
import textwrap
from dataclasses import fields
from functools import cache
from typing import Any

_MARKUP = re.compile(r"`+")
_SENTENCE_END = re.compile(r"(?<! al)\.(?: |$)")


def option_help(cls: type[Any], name: str) -> str:
    """The first sentence on a field, with its default, as argparse wants it.

    Args:
        cls: A dataclass whose fields have docstrings.
        name: Of the field.

    Returns:
        Empty where the source is not there to be read.
    """
    text = _docstrings(cls).get(name, "")
    if not text:
        return ""
    first = _SENTENCE_END.split(_MARKUP.sub("", text), maxsplit=1)[0]
    if not first[1:2].isupper():  # SH, PLY
        first = first[0].lower() + first[1:]
    default = next(f.default for f in fields(cls) if f.name == name)
    shown = f"{default:g}" if isinstance(default, float) else str(default)
    return f"{first} ({shown})".replace("%", "%%")


@cache
def _docstrings(cls: type[Any]) -> dict[str, str]:
    """The string after each field, on one line."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(cls)))
    except (OSError, TypeError, SyntaxError):  # compiled files alone
        return {}
    (definition,) = tree.body
    assert isinstance(definition, ast.ClassDef)
    found = {}
    for field, text in zip(definition.body, definition.body[1:], strict=False):
        if (
            isinstance(field, ast.AnnAssign)
            and isinstance(field.target, ast.Name)
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
        ):
            found[field.target.id] = " ".join(str(text.value.value).split())
    return found

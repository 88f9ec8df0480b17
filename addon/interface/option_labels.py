"""Option labels: command-line flags in gscore's messages, replaced by the names in the panels."""

import re

from ..core import GsError

LABELS: dict[str, str] = {}
"""Option to its name in a panel; `declared` notes them."""
CHOICES: dict[tuple[str, str], str] = {}
"""Option and value to the panel's name of that choice."""
_FLAG = re.compile(r"(?<![\w/-])--([a-z][a-z0-9-]*)(?: (on|off|auto|none|ignore|composite)\b)?")


_OF_PIP = re.compile(r"pip install (?:(?!\. |; ).)*$")
"""The beginning of a command of pip, whose flags are meant to be typed."""


def panel_words(sentence: str) -> str:
    """`sentence` with the names of panels for flags; those that no panel has become options."""
    return _FLAG.sub(_label, sentence)


def error_words(error: Exception | None) -> str:
    """The sentence of an error, with the names of panels where it is one of gscore's; empty for
    none."""
    if error is None:
        return ""
    return panel_words(str(error)) if isinstance(error, GsError) else str(error)


def _label(found: re.Match[str]) -> str:
    flag, value = found.groups()
    option = flag.replace("-", "_")
    label = LABELS.get(option)
    if _OF_PIP.search(found.string, 0, found.start()):
        return found.group()
    if label is None:
        return f"the option {flag.replace('-', ' ')}" + (f" ({value})" if value else "")
    if not value:
        return f'"{label}"'
    return f'"{label}: {CHOICES.get((option, value), value.capitalize())}"'

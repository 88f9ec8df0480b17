"""Option labels: marked options in gscore's messages, shown by their labels in the panels."""

from ..core import GsError, show_options

LABELS = {"resolution": "Photo Size", "device": "Device"}
"""Label of each option in a panel; `declared` adds those that it declares."""
CHOICES: dict[tuple[str, str], str] = {("device", "cpu"): "CPU"}
"""Label of a choice in a panel, by option and value."""


def panel_text(sentence: str) -> str:
    """`sentence` with panel labels for marked options, or "the option ..." for those without."""
    return show_options(sentence, _label)


def error_text(error: Exception | None) -> str:
    """The sentence of an error, with the names of panels where it is one of gscore's; empty for
    none."""
    if error is None:
        return ""
    return panel_text(str(error)) if isinstance(error, GsError) else str(error)


def _label(option: str, value: str) -> str:
    label = LABELS.get(option)
    if label is None:
        return f"the option {option.replace('_', ' ')}" + (f" ({value})" if value else "")
    if not value:
        return f'"{label}"'
    return f'"{label}: {CHOICES.get((option, value), value)}"'

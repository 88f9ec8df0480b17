"""Option marks: the names of options in messages, which each front end shows in its own way.

A mark is the option in backticks, with its value if there is one: "Give fewer `--max-splats`.",
"`--depth-mode on` uses it." Exceptions, events and files contain the marks; the command line prints
the flag without backticks, a panel its own label. Options inside a whole command are not marked.
"""

import re
from collections.abc import Callable

_MARK = re.compile(r"`--([A-Za-z][\w-]*)(?: ([^`\n]*))?`")


def mark_option(name: str) -> str:
    """The mark of an option, by its field name, such as `max_splats`."""
    return f"`--{name.replace('_', '-')}`"


def show_options(message: str, shown: Callable[[str, str], str]) -> str:
    """`message` with `shown(name, value)` in place of each mark; the value is empty if the mark has
    none. A message without marks is returned unchanged."""
    return _MARK.sub(lambda mark: shown(mark[1].replace("-", "_"), mark[2] or ""), message)


def show_flags(message: str) -> str:
    """`message` as the command line prints it: flags without backticks."""
    return _MARK.sub(lambda mark: mark[0][1:-1], message)

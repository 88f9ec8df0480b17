"""Job runner: long work as a command, with progress for people or programs, and control lines."""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from ...control import Control, listen
from ...errors import Cancelled
from ...events import Failed, Show
from ..parser import add_option
from .display import JsonLines, Lines
from .interrupt import interrupts
from .output import print_result

Result = TypeVar("Result")
STOPPED = "Stopped before the first step; nothing was written."
EXIT_WITHOUT_RESULT = 3
"""Exit code of work that was stopped before a result, other than by a signal."""


def add_output_options(
    parser: argparse.ArgumentParser, *, quiet: str = "print errors only"
) -> None:
    """Declare the output options; `quiet`: what `--quiet` does."""
    option = partial(add_option, parser.add_argument_group("output"))
    option("--quiet", quiet)
    option("--events", "events as JSON lines on stdout, commands on stdin", choices=("jsonl",))
    option("--json", "the results as JSON at the end of stdout")


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """The given output options."""

    quiet: bool = False
    events: bool = False
    """Events as JSON lines on stdout, commands on stdin."""
    json: bool = False

    @classmethod
    def of(cls, args: argparse.Namespace) -> "OutputOptions":
        """Read the arguments of a verb with `add_output_options`."""
        return cls(quiet=args.quiet, events=bool(args.events), json=args.json)

    @property
    def is_silent(self) -> bool:
        """Whether users see no text on the terminal."""
        return self.quiet or self.events


def run_job(
    shown: OutputOptions,
    work: Callable[[Show, Control], Result],
    *,
    stopped: Callable[[], str] = lambda: STOPPED,
) -> tuple[Result | None, int]:
    """Run `work`; the command line reports its errors, as `gscore.commands.main` does.

    Args:
        shown: The output options.
        work: Receives the event callback and the control to poll; raises Cancelled if stopped
            without a result.
        stopped: Returns the message on such a stop, sent as an event or printed on stderr.

    Returns:
        What `work` returned, None if it was stopped; and the exit code.
    """
    control = Control()
    show = _display(shown, control)
    quiet = shown.is_silent
    with interrupts() as interrupt, interrupt.stopped_by(control.stop, quiet=quiet):
        try:
            if shown.events:
                listen(control, 0, on_end=lambda: control.stop("input ended"))
            return work(show, control), interrupt.exit_code
        except Cancelled:
            show(Failed(message=stopped(), type="Cancelled"))
            if not quiet:
                print(stopped(), file=sys.stderr)
            return None, interrupt.exit_code or EXIT_WITHOUT_RESULT
        except Exception as error:
            if not shown.events:
                show(Failed(message=str(error)))  # ends the progress line
            raise


def run_verb(
    shown: OutputOptions,
    work: Callable[[Show, Control], Result],
    *,
    facts: Callable[[Result], Any],
    lines: Callable[[Result], list[str]],
    stopped: Callable[[], str] = lambda: STOPPED,
) -> int:
    """Run `work` as `run_job`, print its result as JSON or text, and return the exit code."""
    result, code = run_job(shown, work, stopped=stopped)
    if result is not None and (shown.json or not shown.is_silent):
        print_result(facts(result), [] if shown.json else lines(result), json=shown.json)
    return code


def _display(shown: OutputOptions, control: Control) -> Show:
    if shown.events:
        return JsonLines(sys.stdout, on_closed=lambda: control.stop("output closed"))
    return (lambda event: None) if shown.quiet else Lines(sys.stderr)

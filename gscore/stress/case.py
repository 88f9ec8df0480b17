"""Stress case: a named function that measures errors, and the list of all cases."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass


class EmptyTestError(AssertionError):
    """A case whose input does not exercise its subject, so that it could not fail."""


class UnsupportedMachineError(Exception):
    """Raised by a case that cannot run on this machine, with the reason."""


@dataclass(frozen=True)
class Measure:
    """One error of a case."""

    what: str
    """Measured quantity, a few words."""
    error: float
    """Passes if at most `tolerance`; NaN fails (join errors with np.max, because max may lose it).
    Counts of violations have tolerance 0."""
    tolerance: float
    note: str = ""
    skipped: bool = False
    """Not measured, for the reason in `note`."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One stress test."""

    key: str
    """S01 to S36, in the order of docs/accuracy-tests.md."""
    title: str
    run: Callable[[bool], Iterable[Measure]]
    """The argument selects the long version."""
    per_isa: bool
    """Run for each instruction set."""
    on_device: bool
    """Runs on graphics cards too."""
    needs: tuple[str, ...]
    """Required packages; skipped without them."""
    slow: bool
    """Run in the full suite only."""

    @property
    def name(self) -> str:
        """Key and title."""
        return f"{self.key} {self.title}"


CASES: list[Case] = []
"""All cases, filled as their modules are imported; see `run`."""


def case(
    key: str,
    title: str,
    *,
    per_isa: bool = True,
    on_device: bool = False,
    needs: tuple[str, ...] = ("torch",),
    slow: bool = False,
) -> Callable[[Callable[[bool], Iterable[Measure]]], Callable[[bool], Iterable[Measure]]]:
    """Decorator that adds a function to the list of cases."""

    def enter(function: Callable[[bool], Iterable[Measure]]):
        CASES.append(
            Case(
                key=key,
                title=title,
                run=function,
                per_isa=per_isa,
                on_device=on_device,
                needs=needs,
                slow=slow,
            )
        )
        return function

    return enter

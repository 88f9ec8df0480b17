"""One test for many files or numbers, which fails with a line for each that is wrong."""

from collections.abc import Callable, Iterable
from pathlib import Path

ROOT = Path(__file__).parent.parent


def for_each(things: Iterable) -> Callable[[Callable[..., None]], Callable[[], None]]:
    """Decorator of a test of one thing; a tuple is its arguments.

    Cheaper than a test for each, which costs milliseconds in every process that collects it.
    """
    cases = [thing if isinstance(thing, tuple) else (thing,) for thing in things]

    def decorate(test: Callable[..., None]) -> Callable[[], None]:
        def test_all() -> None:
            assert cases
            problems = []
            for case in cases:
                try:
                    test(*case)
                except AssertionError as error:
                    problems.append(f"{', '.join(map(_name, case))}: {error}")
            assert not problems, "\n".join(problems)

        test_all.__name__, test_all.__doc__ = test.__name__, test.__doc__
        return test_all

    return decorate


def _name(thing: object) -> str:
    inside = isinstance(thing, Path) and thing.is_relative_to(ROOT)
    return str(thing.relative_to(ROOT) if inside else thing)

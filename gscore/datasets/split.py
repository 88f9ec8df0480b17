"""Split of the views into training views and held-out test views."""

from collections.abc import Collection, Sequence
from pathlib import Path, PurePosixPath

from ..config import DataConfig
from ..errors import ConfigError, DatasetError
from ..hold_out import FORMS
from ..io.files import read_bytes
from ..quoting import first_few, quoted
from ..text_format import count_text, number
from .folder import same_name


def split_views(
    names: Sequence[str], config: DataConfig, *, stated: Collection[str] = ()
) -> tuple[list[int], list[int]]:
    """Divide views into train and test.

    Args:
        names: Names of the views, sorted.
        config: `eval` off: all train. Otherwise the first of these that applies: `test_list`;
            `test_first` and `test_last`; the capture's own split, unless there is a `test_offset`;
            every `test_every`-th view, from that offset (the rule of the 3DGS paper with 8 and 0).
        stated: Names of test views stated by the capture.

    Returns:
        Indices of training views and of test views, each ascending.

    Raises:
        ConfigError: a number is out of range.
        DatasetError: the list has views that do not exist, or nothing is left to train or to test.
    """
    count = len(names)
    if not config.eval:
        return list(range(count)), []
    if config.test_first < 0 or config.test_last < 0:
        raise ConfigError(
            f"test_first and test_last must not be negative, got {quoted(config.test_first)} and "
            f"{quoted(config.test_last)}."
        )
    if config.test_list is not None:
        test = _listed(names, config.test_list)
        rule = f"the list {config.test_list}"
    elif config.test_first or config.test_last:
        test = {i for i in range(count) if i < config.test_first or i >= count - config.test_last}
        ends = {"first": config.test_first, "last": config.test_last}
        named = [f"{end} {count_text(n, 'view')}" for end, n in ends.items() if n]
        rule = f"the {' and '.join(named)}"
    elif stated and config.test_offset is None:
        known = set(map(same_name, stated))
        test = {i for i, name in enumerate(names) if same_name(name) in known}
        rule = "the capture's own split"
    else:
        if config.test_every < 2:
            raise ConfigError(f"test_every must be at least 2, got {quoted(config.test_every)}.")
        offset = config.test_offset or 0
        if not 0 <= offset < config.test_every:
            raise ConfigError(
                f"test_offset must be 0 to {config.test_every - 1}, less than test_every, got "
                f"{offset}."
            )
        test = set(range(offset, count, config.test_every))
        rule = f"every {config.test_every}th view" + (f" from place {offset}" if offset else "")
    if not test or len(test) == count:
        left = "no view to test" if not test else "no view to train"
        raise DatasetError(
            f"The test split ({rule}) leaves {left}: {len(test)} of {count_text(count, 'view')} "
            "are test views. Choose another rule, or hold no view out."
        )
    return [i for i in range(count) if i not in test], sorted(test)


def is_chosen(config: DataConfig, *, stated: Collection[str] = ()) -> bool:
    """True if test views are every n-th, not listed; arguments as of `split_views`."""
    by_count = config.test_list is None and not (config.test_first or config.test_last)
    return by_count and not (stated and config.test_offset is None)


def split_warnings(count: int, test: Sequence[int], config: DataConfig) -> list[str]:
    """Warning if the interval between two test views is larger than the number of views.

    Args:
        count: Number of all views.
        test: Test views, as from `split_views`.
        config: The rule.
    """
    if not (config.eval and is_chosen(config) and len(test) == 1 and config.test_every > count):
        return []
    fewer = max(2, count // 3)
    more = (
        f"`--hold-out {fewer}` measures {number(len(range(0, count, fewer)))}."
        if fewer < count
        else "Take more photos."
    )
    return [
        f"One of {number(config.test_every)} views is held out, but there are only "
        f"{count_text(count, 'view')}: only one view is measured, which is unreliable. {more}"
    ]


def read_list(path: Path) -> bytes:
    """The bytes of a list of test views.

    Raises:
        DatasetError: the file is missing, or cannot be read.
    """
    if not path.exists():
        raise DatasetError(f"`--hold-out {path}`: there is no such file; give {FORMS}.")
    return read_bytes(path)


def _listed(names: Sequence[str], path: Path) -> set[int]:
    """Indices of the views listed in a text file; folder and ending may be omitted if unique."""
    try:
        lines = read_list(path).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise DatasetError(
            f"{path} is not UTF-8 text. Give a text file with the name of a test view on each line."
        ) from error
    lookup: dict[str, set[int]] = {}
    for i, name in enumerate(map(same_name, names)):
        pure = PurePosixPath(name)
        for form in {name, pure.name, pure.stem, str(pure.with_suffix(""))}:
            lookup.setdefault(form, set()).add(i)
    for i, name in enumerate(map(same_name, names)):  # a whole name is never ambiguous
        lookup[name] = {i}
    wanted = [line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]
    unknown = [name for name in wanted if len(lookup.get(same_name(name), ())) != 1]
    if unknown:
        raise DatasetError(
            f"{path} has {count_text(len(unknown), 'view')} that the capture does not have, or "
            "not only once: "
            f"{first_few(unknown)}. An example of a name is "
            f"{names[0]}."
        )
    return {next(iter(lookup[same_name(name)])) for name in wanted}

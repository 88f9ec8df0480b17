"""Division into training and test views, by hand."""

from collections.abc import Callable
from pathlib import Path

import pytest

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.datasets.split import split_views
from gscore.errors import ConfigError, DatasetError
from gscore.inspection import inspect

from .conftest import SmallCapture

_NAMES = [f"cam/{i:02d}.jpg" for i in range(20)]


def _config(**options: object) -> DataConfig:
    return DataConfig(source=Path(), **({"eval": True} | options))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "test"),
    [
        ({}, [0, 8, 16]),
        ({"test_every": 6}, [0, 6, 12, 18]),
        ({"test_every": 2}, list(range(0, 20, 2))),
        ({"test_offset": 0}, [0, 8, 16]),
        ({"test_offset": 3}, [3, 11, 19]),
        ({"test_offset": 5, "test_every": 6}, [5, 11, 17]),
        ({"test_first": 1, "test_offset": 5}, [0]),
        ({"test_first": 3}, [0, 1, 2]),
        ({"test_last": 2}, [18, 19]),
        ({"test_first": 1, "test_last": 1}, [0, 19]),
        ({"test_last": 2, "test_every": 1}, [18, 19]),
        ({"eval": False}, []),
        ({"eval": False, "test_last": 2}, []),
    ],
)
def test_rules(options: dict[str, object], test: list[int]) -> None:
    """Oracle: indices counted by hand; the paper's rule takes every 8th from the first."""
    train, held = split_views(_NAMES, _config(**options))
    assert held == test
    assert train == [i for i in range(20) if i not in test]


def test_list_wins(tmp_path: Path) -> None:
    """Oracle: the written names; comments, blank lines, missing folder or ending are fine."""
    path = tmp_path / "test.txt"
    path.write_text("# held out\n\ncam/03.jpg\n05.jpg\r\n07\ncam/09\n")
    _, held = split_views(_NAMES, _config(test_list=path, test_last=2), stated={"cam/00.jpg"})
    assert held == [3, 5, 7, 9]


def test_stated_by_the_capture() -> None:
    """Oracle: its own split, which overrides every 8th, and is overridden by an explicit rule."""
    stated = {"cam/04.jpg"}
    assert split_views(_NAMES, _config(), stated=stated)[1] == [4]
    assert split_views(_NAMES, _config(test_last=1), stated=stated)[1] == [19]
    assert split_views(_NAMES, _config(test_offset=0), stated=stated)[1] == [0, 8, 16]
    assert split_views(_NAMES, _config(eval=False), stated=stated)[1] == []


def test_unknown_and_ambiguous_names(tmp_path: Path) -> None:
    """Oracle: the sentence, with the names and examples of valid ones."""
    path = tmp_path / "test.txt"
    path.write_text("\n".join(["03", *(f"no{i}" for i in range(7))]))
    with pytest.raises(DatasetError) as caught:
        split_views(_NAMES, _config(test_list=path))
    message = str(caught.value)
    assert "has 7 views" in message and "no0, no1, no2, no3, no4 and 2 more" in message
    assert "cam/00.jpg" in message
    path.write_text("03")
    twice = ["a/03.jpg", "b/03.jpg", "c/04.jpg"]
    with pytest.raises(DatasetError, match="not only once: 03"):
        split_views(twice, _config(test_list=path))


def test_list_that_is_missing_or_no_text(tmp_path: Path) -> None:
    """Oracle: the sentence, with the file."""
    with pytest.raises(
        DatasetError, match=r"--hold-out .*none\.txt`: there is no such file; give a number N"
    ):
        split_views(_NAMES, _config(test_list=tmp_path / "none.txt"))
    (tmp_path / "bin.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DatasetError, match=r"bin\.txt is not UTF-8"):
        split_views(_NAMES, _config(test_list=tmp_path / "bin.txt"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"test_every": 1}, "test_every must be at least 2, got 1"),
        ({"test_every": 0}, "test_every must be at least 2, got 0"),
        ({"test_offset": 8}, "test_offset must be 0 to 7, less than test_every, got 8"),
        ({"test_offset": -1}, "test_offset must be 0 to 7, less than test_every, got -1"),
        ({"test_first": -1}, "must not be negative"),
        ({"test_last": -5}, "must not be negative"),
    ],
)
def test_numbers_out_of_range(options: dict[str, object], message: str) -> None:
    """Oracle: the documented limits."""
    with pytest.raises(ConfigError, match=message):
        split_views(_NAMES, _config(**options))


def test_split_without_views_on_one_side_is_refused(tmp_path: Path) -> None:
    """Oracle: the error, because a split needs views on both sides."""
    with pytest.raises(DatasetError, match="leaves no view to train: 20 of 20"):
        split_views(_NAMES, _config(test_last=25))
    with pytest.raises(DatasetError, match="leaves no view to train"):
        split_views(["one.jpg"], _config())
    (tmp_path / "empty.txt").write_text("# none\n")
    with pytest.raises(DatasetError, match="leaves no view to test"):
        split_views(_NAMES, _config(test_list=tmp_path / "empty.txt"))


def test_single_held_out_view_warns(make_capture: Callable[..., SmallCapture]) -> None:
    """Oracle: 9 views: every 40th is the first alone; every 8th are two."""
    capture = make_capture(views=9)
    for every, reported in ((40, 1), (8, 0)):
        config = DataConfig(source=capture.root, eval=True, test_every=every)
        words = [w for w in load_dataset(config).warnings if "only one view is measured" in w]
        assert len(words) == reported
        assert all("`--hold-out 3` measures 3." in w for w in words)
        assert [p.text for p in inspect(config).problems if p.text in words] == words
    plain = DataConfig(source=capture.root, test_every=40)
    assert not any("held out" in w for w in load_dataset(plain).warnings)


@pytest.mark.parametrize(
    ("options", "rule"),
    [
        ({"test_first": 20}, r"\(the first 20 views\)"),
        ({"test_last": 30}, r"\(the last 30 views\)"),
        ({"test_first": 19, "test_last": 1}, r"\(the first 19 views and last 1 view\)"),
    ],
)
def test_a_split_that_leaves_nothing_names_its_rule(options: dict[str, int], rule: str) -> None:
    """Oracle: only ends that are held out are named."""
    with pytest.raises(DatasetError, match=rule):
        split_views(_NAMES, _config(**options))

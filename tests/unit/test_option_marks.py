"""Marked options in messages; oracle: the flags of the command line's own parsers."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import gscore
from gscore.config import DataConfig, TrainConfig
from gscore.live_options import LiveOptions
from gscore.option_marks import mark_option, show_flags, show_options
from gscore.options import options_of
from gscore.sequence_options import SequenceOptions

ROOT = Path(gscore.__file__).parent
TREES = {
    path.relative_to(ROOT).as_posix(): ast.parse(text)
    for path in sorted(ROOT.rglob("*.py"))
    if "--" in (text := path.read_text(encoding="utf-8"))
}
"""Syntax trees of the files with flags."""
HELP = {
    *("add_argument", "add_argument_group", "add_parser", "add_option", "Option", "option"),
    *("which", "Row"),
}
"""Calls whose texts are help of the command line."""
TORCHRUN = {"--master-addr", "--master-port", "--rdzv-endpoint", "--max-restarts"}
FLAG = re.compile(r"""(?<![\w/`"-])--[A-Za-z][\w-]*""")
COMMAND = re.compile(
    r"(?:gscore [a-z]+|pip install|<code>|See \{\})(?:[^.;:`)]|[.:](?! ))*$|^Example: |^ $"
)
"""The beginning of a command to type, whose flags are not marked, up to the end of its clause."""


@pytest.mark.parametrize(
    ("message", "flags", "parts"),
    [
        ("Give `--max-splats`.", "Give --max-splats.", [("max_splats", "")]),
        ("`--a-b on`; `--shN-lr`", "--a-b on; --shN-lr", [("a_b", "on"), ("shN_lr", "")]),
        ("`--path /a b/c.json`: no", "--path /a b/c.json: no", [("path", "/a b/c.json")]),
        ("an old one: --a on", "an old one: --a on", []),
        ("a`b, `gscore train --a`, `--c", "a`b, `gscore train --a`, `--c", []),
        ("", "", []),
    ],
)
def test_marks_are_data(message: str, flags: str, parts: list[tuple[str, str]]) -> None:
    """Oracle: the option and value of each mark, and the message without marks, by hand."""
    found: list[tuple[str, str]] = []
    show_options(message, lambda option, value: found.append((option, value)) or "")
    assert (show_flags(message), found) == (flags, parts)


@pytest.mark.parametrize("name", ["max_splats", "shN_lr", "resolution"])
def test_a_made_mark_is_read_back(name: str) -> None:
    """Oracle: the option's name."""
    assert show_options(mark_option(name), lambda option, value: f"{option}{value}") == name


def test_every_option_in_a_message_is_marked() -> None:
    """Oracle: all string literals of gscore. Exceptions are docstrings, help texts, single flags
    (arguments) and commands to type."""
    missed = [
        f"{path}:{line}: {text[flag.start() :][:40]}"
        for path, tree in TREES.items()
        for line, text in _messages(tree)
        for flag in FLAG.finditer(text)
        if not COMMAND.search(text[: flag.start()])
    ]
    assert missed == []


def test_each_marked_option_is_a_flag() -> None:
    """Oracle: flags that parsers of the package or torchrun declare, read off the syntax trees."""
    marked: set[str] = set()
    declared = TORCHRUN | {"--{}", "--sweep-{}"}
    for cls in (DataConfig, TrainConfig, LiveOptions, SequenceOptions):
        declared |= {one.flag for one in options_of(cls).values()}
    for tree in TREES.values():
        for _, text in _messages(tree):
            marked |= set(re.findall(r"`(--[\w{}-]+)(?: [^`]*)?`", text))
        declared |= {
            flag
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and str(node.value).startswith("-")
            for flag in re.findall(r"(?:^|, )(--[\w-]+)", str(node.value))
        }
    declared |= {f"--no-{flag[2:]}" for flag in declared}
    assert len(marked) > 50 and marked <= declared, marked - declared


def _messages(node: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of the literals that are neither docstrings, help texts nor single flags; {}
    stands for each inserted value."""
    if _is_help(node) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
        return
    if isinstance(node, ast.JoinedStr | ast.Constant):
        text = _text(node)
        if not re.fullmatch(r"--[\w-]+=?", text):
            yield node.lineno, text
    for child in ast.iter_child_nodes(node):
        if not (isinstance(node, ast.JoinedStr) and isinstance(child, ast.Constant)):
            yield from _messages(child)


def _text(node: ast.AST) -> str:
    if isinstance(node, ast.JoinedStr):
        return "".join(map(_text, node.values))
    return str(node.value) if isinstance(node, ast.Constant) else "{}"


def _is_help(node: ast.AST) -> bool:
    called = node.func if isinstance(node, ast.Call) else None
    return getattr(called, "attr", getattr(called, "id", "")) in HELP

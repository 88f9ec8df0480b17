"""Commands and code of the docs; oracle: they run from top to bottom as they stand there.

A page gets a folder with the names it uses: `photos/`, `examples/studio` and `CASE` are the bundled
capture made small, `midas.onnx` is a network of three taps. Presets train twenty steps, and `SMALL`
lists the numbers that are lowered. Fences without a language hold commands; what a program prints
is fenced as `text`.
"""

import contextlib
import io
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from gscore.commands import main
from gscore.presets import PRESETS, RECIPES
from tests.depth.conftest import midas
from tests.docs.small_studio import ROOT, write_small_studio, write_small_video

PAGES = (
    "README.md",
    "docs/python.md",
    "docs/extending.md",
    "docs/budgets.md",
    "docs/sequences.md",
    "docs/metrics.md",
    "docs/convert.md",
)
STEPS = 20
SMALL = {
    "iterations=1500": f"iterations={STEPS}",
    "STEPS = 1500": f"STEPS = {STEPS}",
    "step % 300 == 299": "step % 5 == 4",
    "--iterations 2000": f"--iterations {STEPS}",
    "--next-iterations 500": "--next-iterations 10",
    "--next-iterations 250": "--next-iterations 5",
    "--time-budget 120": "--time-budget 0.5",
    "--frames 0:145:5": "--frames 0:6:5",
    "-r 240": "-r 60",
}
SLOW = ("gscore stress", "gscore bench")
"""Beginnings of commands that take long however little they are given, and leave nothing."""
SLOW_BLOCKS = ("python ", "gscore depth photos/ --model ")
"""Beginnings of commands that take long and leave what the rest of their block needs."""


@dataclass(frozen=True)
class Block:
    """A fenced block."""

    page: str
    line: int
    language: str
    text: str


def blocks(page: str) -> list[Block]:
    """The fenced blocks of a page in their order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    found = re.finditer(r"^```(\w*)\n(.*?)^```$", text, re.M | re.S)
    return [Block(page, text[: m.start()].count("\n") + 1, m[1], m[2]) for m in found]


def commands(block: Block) -> list[str]:
    """The commands of a block: one a line, unless a line ends in a backslash."""
    lines = block.text.replace("\\\n", " ").splitlines()
    return [line for line in lines if line.strip()]


def small(text: str) -> str:
    """Code or a command with `SMALL` applied."""
    for large, little in SMALL.items():
        text = text.replace(large, little)
    return text


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that every page starts with. Do not change it."""
    folder = tmp_path_factory.mktemp("docs")
    write_small_studio(folder / "photos")
    shutil.copytree(folder / "photos", folder / "examples/studio")
    shutil.rmtree(folder / "photos/depths")
    (folder / "photos/sparse/0/depth_params.json").unlink()
    shutil.rmtree(folder / "photos/masks")
    write_small_video(folder / "CASE", folder / "photos", 6)
    shutil.copy(ROOT / "examples/make_sequence.py", folder / "examples")
    (folder / "tools/measure").mkdir(parents=True)
    shutil.copy(ROOT / "tools/measure/sequence.py", folder / "tools/measure")
    midas(folder / "midas.onnx")
    return folder


@pytest.fixture
def page_folder(prepared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A copy of it to work in, and presets that take a second."""
    folder = tmp_path / "page"
    shutil.copytree(prepared, folder)
    monkeypatch.chdir(folder)
    for name in ("GSCORE_DATA", "GSCORE_LPIPS"):
        monkeypatch.delenv(name, raising=False)
    for presets in (PRESETS, RECIPES):
        for name, make in list(presets.items()):
            monkeypatch.setitem(presets, name, _shortened(make))
    yield folder


def _shortened(make: Callable[[Path], Any]) -> Callable[[Path], Any]:
    def short(source: Path) -> Any:
        data, train = make(source)
        return data, replace(train, iterations=STEPS, max_splats=8000)

    return short


def run(command: str, *, slow: bool) -> None:
    """Run a command, or check its words where it takes long and that is not wanted."""
    words = shlex.split(small(command), comments=True)
    if words[0] == "make":
        subprocess.run([*words[:1], "-n", *words[1:]], cwd=ROOT, check=True, capture_output=True)
    elif words[0] == "pip":
        _check_pip(words)
    elif words[0] == "source":
        venv = re.search(r"^VENV := (.+)$", (ROOT / "Makefile").read_text(), re.M)
        assert venv and words[1:] == [f"{venv[1]}/bin/activate"]
    elif command.startswith(SLOW) and not slow:
        _check_words(words)
    elif words[0] == "python":
        done = subprocess.run([sys.executable, *words[1:]], capture_output=True, text=True)
        assert done.returncode == 0, f"{command}\n{done.stderr}"
    else:
        assert words[0] == "gscore", f"{command}: fence what is no command as `text`"
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(words[1:])
        assert code == 0, f"{command}\n{out.getvalue()[-500:]}{err.getvalue()[-500:]}"


def _check_pip(words: list[str]) -> None:
    """Extras that are there, and the index that gscore itself names."""
    from gscore.extras import install_hint

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (asked,) = re.findall(r"\.\[(.*)\]", " ".join(words))
    assert set(asked.split(",")) <= set(project["optional-dependencies"])
    assert words[words.index("--extra-index-url") + 1] in install_hint("torch")


def _check_words(words: list[str]) -> None:
    """A verb and a measurement that are there."""
    with contextlib.redirect_stdout(io.StringIO()):
        assert main([*words[1:], "--help"]) == 0


def run_page(page: str, *, slow: bool) -> int:
    """Run what stands on a page; returns how many blocks that were."""
    scope: dict[str, Any] = {}
    count = 0
    for block in blocks(page):
        if block.language == "python":
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile("\n" * block.line + small(block.text), page, "exec"), scope)
        elif block.language in ("", "sh"):
            needed = commands(block)
            if not slow and any(command.startswith(SLOW_BLOCKS) for command in needed):
                continue
            for command in needed:
                run(command, slow=slow)
        else:
            continue
        count += 1
    return count


COUNTS = {
    "README.md": 7,
    "docs/python.md": 2,
    "docs/extending.md": 1,
    "docs/budgets.md": 4,
    "docs/sequences.md": 1,
    "docs/convert.md": 4,
}


@pytest.mark.parametrize("page", PAGES)
def test_commands_and_code_of_pages_run(page: str, page_folder: Path) -> None:
    """Oracle: exit codes and exceptions; blocks are counted, so that none is passed over."""
    assert run_page(page, slow=False) == COUNTS.get(page, 0)


@pytest.mark.slow
@pytest.mark.parametrize("page", ["README.md", "docs/sequences.md"])
def test_slow_commands_of_pages_run(page: str, page_folder: Path) -> None:
    """Oracle: exit codes, of programs beside gscore too."""
    assert run_page(page, slow=True) == len(
        [b for b in blocks(page) if b.language in ("", "sh", "python")]
    )


def test_every_replacement_is_of_use() -> None:
    """Oracle: the pages; a number that is lowered stands on one of them."""
    text = "".join(block.text for page in PAGES for block in blocks(page))
    assert [large for large in SMALL if large not in text] == []

"""What a release is made of; oracle: the workflows, Blender's format of an index, the files."""

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import gscore

ROOT = Path(__file__).parent.parent
TOOLS = ROOT / "tools" / "build"
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def _tool(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(TOOLS))
    spec = importlib.util.spec_from_file_location(name, TOOLS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_tools_that_workflows_run_are_there() -> None:
    """Oracle: the folder and the Makefile's targets."""
    assert {path.name for path in WORKFLOWS} == {"nightly.yml", "release.yml", "test.yml"}
    text = "\n".join(path.read_text() for path in WORKFLOWS)
    tools = set(re.findall(r"tools/build/(\w+\.py)", text))
    assert tools >= {"release_notes.py", "release_wheels.py", "extension_index.py"}
    assert all((TOOLS / name).is_file() for name in tools)
    targets = set(re.findall(r"run: make ([\w-]+)", text))
    makefile = (ROOT / "Makefile").read_text()
    assert targets >= {"lint", "test", "extension", "test-slow", "sanitize"}
    assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in targets)


def test_actions_are_pinned() -> None:
    """Oracle: 40 hex digits after each action that is not our own."""
    for path in WORKFLOWS:
        used = re.findall(r"uses: (\S+)", path.read_text())
        assert used and all(
            re.fullmatch(r"[\w/-]+@[0-9a-f]{40}", name) or name.startswith("./") for name in used
        )


def test_the_tag_must_be_the_version(tmp_path: Path) -> None:
    """Oracle: exit codes, and the section of CHANGELOG.md."""

    def run(tag: str) -> int:
        script = [sys.executable, TOOLS / "release_notes.py", tag, "--output", tmp_path / "n.md"]
        return subprocess.run(script, capture_output=True, check=False).returncode

    assert run(f"v{gscore.__version__}") == 0
    notes = (tmp_path / "n.md").read_text()
    assert notes.startswith("- ") and notes.strip() in (ROOT / "CHANGELOG.md").read_text()
    assert run("v9.9.9") == 1 and run(gscore.__version__) == 1


def test_a_section_ends_where_the_next_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: a change log by hand."""
    tool = _tool("release_notes", monkeypatch)
    text = "# Log\n\n## 1.1.0 (today)\n\n- b\n\n## 1.0.0\n\n- a\n"
    assert [tool.section(text, v) for v in ("1.1.0", "1.0.0", "2.0.0")] == ["- b", "- a", ""]


def test_an_index_that_lacks_something_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: Blender's format v1, with two zips by hand."""
    tool = _tool("extension_index", monkeypatch)
    zips = [Path("a.zip"), Path("b.zip")]

    def entry(platform: str) -> dict:
        return {
            "id": "x",
            "version": "1.0.0",
            "platforms": [platform],
            "archive_url": f"./{platform}.zip",
            "archive_size": 1,
            "archive_hash": "sha256:0",
        }

    good = {"version": "v1", "data": [entry("linux-x64"), entry("macos-x64")]}
    assert len(tool.checked(good, zips)) == 2
    for bad in (
        {"version": "v2", "data": good["data"]},
        {"version": "v1", "data": good["data"][:1]},
        {"version": "v1", "data": [entry("linux-x64"), entry("linux-x64")]},
        {"version": "v1", "data": [entry("linux-x64"), entry("macos-x64") | {"archive_hash": ""}]},
    ):
        with pytest.raises(RuntimeError):
            tool.checked(json.loads(json.dumps(bad)), zips)

"""Models in several files, replaced in place; oracle: the old model or the new one."""

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gscore.errors import FormatError, GsError
from gscore.formats import files_of, parts, read_splat_file, read_splats, write_splat_file
from gscore.io import files

from .conftest import MakeModel

NAMES = ("meta.json", "a.gltf", "a.spz.gltf")


@pytest.mark.parametrize("name", NAMES)
def test_one_model_replaces_another(make_model: MakeModel, tmp_path: Path, name: str) -> None:
    """Oracle: the last model, the files in its index, and none of the previous ones."""
    (tmp_path / "notes.webp").write_bytes(b"mine")
    (tmp_path / "b.bin").write_bytes(b"mine")
    for seed in range(3):
        written = write_splat_file(tmp_path / name, make_model(300 + seed, 2 - seed, seed))
        found = read_splat_file(tmp_path / name)
        assert len(found.splats) == 300 + seed
        own = files_of(tmp_path / name)
        assert {*tmp_path.iterdir()} == {*own, tmp_path / "notes.webp", tmp_path / "b.bin"}
        size = sum(file.stat().st_size for file in own)
        assert size == written.storage_bytes == found.storage_bytes
    assert (tmp_path / "notes.webp").read_bytes() == (tmp_path / "b.bin").read_bytes() == b"mine"


@pytest.mark.parametrize("name", NAMES)
def test_a_write_that_fails_leaves_the_old_model(
    make_model: MakeModel, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the old model's means and files, for any number of parts that fit on the disk."""
    write_splat_file(tmp_path / name, make_model(300, 1, 1))
    old, there = read_splats(tmp_path / name).means, {*tmp_path.iterdir()}
    real, count = parts.atomic_write, len(there)
    for room in range(count):
        left = iter(range(room))

        def full(path: Path, content: parts.Content, left: object = left) -> None:
            if next(left, None) is None:  # pyright: ignore
                raise GsError("the disk is full")
            real(path, content)

        monkeypatch.setattr(parts, "atomic_write", full)
        with pytest.raises(GsError, match="full"):
            write_splat_file(tmp_path / name, make_model(300, 1, 2))
        np.testing.assert_array_equal(read_splats(tmp_path / name).means, old)
        assert {*tmp_path.iterdir()} == there


class Killed(BaseException):
    """Ends a write as an interrupt does."""


@pytest.mark.parametrize("name", NAMES)
def test_a_killed_write_leaves_one_whole_model(
    make_model: MakeModel, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the old model after a kill at any rename, and the new one without a kill."""
    write_splat_file(tmp_path / name, make_model(300, 1, 1))
    old = read_splats(tmp_path / name).means
    for before in range(len([*tmp_path.iterdir()])):
        renames = iter(range(before))

        def replace(old: Path, new: Path, renames: object = renames, real=Path.replace) -> Path:
            if next(renames, None) is None:  # pyright: ignore
                raise Killed
            return real(old, new)

        with monkeypatch.context() as patch, pytest.raises(Killed):
            patch.setattr(Path, "replace", replace)
            write_splat_file(tmp_path / name, make_model(300, 1, 2))
        np.testing.assert_array_equal(read_splats(tmp_path / name).means, old)
        assert {*tmp_path.iterdir()} == {*files_of(tmp_path / name)}  # an interrupt tidies
    write_splat_file(tmp_path / name, make_model(301, 1, 2))
    assert len(read_splats(tmp_path / name)) == 301


_DYING = """
import os, signal, sys
from pathlib import Path
from gscore.formats import read_splats, write_splat_file
real, left = Path.replace, [int(sys.argv[3])]
def replace(old, new):
    if left[0]:
        real(old, new)
    left[0] -= 1
    if left[0] <= 0:
        os.kill(os.getpid(), signal.SIGKILL)
Path.replace = replace
write_splat_file(Path(sys.argv[1]), read_splats(Path(sys.argv[2])))
"""


def _killed_write(index: Path, model: Path, renames: int) -> None:
    """Write a model in a process that is killed after so many renames; 0: before the first."""
    line = [sys.executable, "-c", _DYING, str(index), str(model), str(renames)]
    assert subprocess.run(line, check=False).returncode == -signal.SIGKILL


@pytest.mark.skipif(sys.platform == "win32", reason="Windows removes no file that was open")
@pytest.mark.parametrize(
    ("name", "renames", "parts_made", "first"),
    [("a.gltf", 0, 0, True), ("a.gltf", 1, 1, False), ("a.gltf", 2, 1, False),
     ("meta.json", 2, 2, True), ("meta.json", 6, 5, False), ("a.spz.gltf", 1, 1, True)],
)  # fmt: skip
def test_parts_of_killed_writes_are_removed(
    make_model: MakeModel,
    tmp_path: Path,
    name: str,
    renames: int,
    parts_made: int,
    first: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Oracle: the names in the folder after the next write: the model's files and the user's own,
    among them one that has taken the name of a part of the killed write."""
    monkeypatch.setattr(files, "_LIST_AGAIN", -1.0)
    folder = tmp_path / "out"
    index = folder / name
    write_splat_file(tmp_path / "given.ply", make_model(40, 0))
    if not first:
        write_splat_file(index, make_model(30))
    folder.mkdir(exist_ok=True)
    mine = {folder / "b.2.bin", folder / "means_l.9.webp", folder / "notes.json"}
    for path in mine:
        path.write_bytes(b"mine")
    there = {*folder.iterdir()}
    _killed_write(index, tmp_path / "given.ply", renames)
    made = {path for path in folder.iterdir() if path.name[0] != "."} - there - {index}
    assert len(made) == parts_made
    if renames == 1:
        taken = made.pop()
        taken.write_bytes(b"mine")
        mine.add(taken)
    write_splat_file(index, make_model(41))
    assert {*folder.iterdir()} == {*files_of(index), *mine}
    assert all(path.read_bytes() == b"mine" for path in mine)
    assert len(read_splats(index)) == 41


@pytest.mark.skipif(sys.platform == "win32", reason="Windows removes no file that was open")
def test_a_renamed_model_keeps_parts_of_a_killed_write(
    make_model: MakeModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the model of a killed write that was complete but for its tidying, under the new
    name of its index, after another was written under the old name; and the old index, damaged
    meanwhile, whose parts stay."""
    monkeypatch.setattr(files, "_LIST_AGAIN", -1.0)
    write_splat_file(tmp_path / "given.ply", make_model(40, 0))
    write_splat_file(tmp_path / "a.gltf", make_model(30))
    old = (tmp_path / "a.bin").read_bytes()
    _killed_write(tmp_path / "a.gltf", tmp_path / "given.ply", 1)
    text = (tmp_path / "a.gltf").read_bytes()
    (tmp_path / "a.gltf").write_bytes(text[:-1])
    write_splat_file(tmp_path / "a.gltf", make_model(31))
    assert (tmp_path / "a.bin").read_bytes() == old
    _killed_write(tmp_path / "a.gltf", tmp_path / "given.ply", 2)
    (tmp_path / "a.gltf").rename(tmp_path / "b.gltf")
    write_splat_file(tmp_path / "a.gltf", make_model(32))
    assert (len(read_splats(tmp_path / "a.gltf")), len(read_splats(tmp_path / "b.gltf"))) == (
        32,
        40,
    )


@pytest.mark.parametrize("name", NAMES)
def test_exchanged_parts_are_refused(make_model: MakeModel, tmp_path: Path, name: str) -> None:
    """Oracle: the name of each part taken from another model of the same number of splats; files
    without checksums are read as before."""
    for folder, seed in (("one", 1), ("two", 2)):
        write_splat_file(tmp_path / folder / name, make_model(300, 1, seed))
    index = tmp_path / "one" / name
    for part in files_of(index) - {index}:
        own = part.read_bytes()
        shutil.copy(tmp_path / "two" / part.name, part)
        if part.read_bytes() != own:
            with pytest.raises(FormatError, match=f"'{part.name}' next to it is not the part"):
                read_splats(index)
        part.write_bytes(own)
    content = json.loads(index.read_text())
    content["asset"].pop("crc32", None)
    for buffer in content.get("buffers", ()):
        del buffer["extras"]
    index.write_text(json.dumps(content))
    assert len(read_splats(index)) == 300


def test_parts_of_other_programs_stay(make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: the bytes of a buffer that another program's glTF shares with others, and of a file
    outside its folder that an index names."""
    write_splat_file(tmp_path / "a.gltf", make_model(30))
    content = json.loads((tmp_path / "a.gltf").read_text())
    content["asset"]["generator"] = "another program"
    (tmp_path / "a.gltf").write_text(json.dumps(content))
    kept = (tmp_path / "a.bin").read_bytes()
    write_splat_file(tmp_path / "a.gltf", make_model(31))
    assert (tmp_path / "a.bin").read_bytes() == kept and len(read_splats(tmp_path / "a.gltf")) == 31
    (tmp_path / "in").mkdir()
    content["asset"]["generator"] = "gscore 1"
    content["buffers"][0]["uri"] = "../a.bin"
    (tmp_path / "in" / "b.gltf").write_text(json.dumps(content))
    write_splat_file(tmp_path / "in" / "b.gltf", make_model(32))
    assert (tmp_path / "a.bin").read_bytes() == kept


def test_a_copied_index_leaves_the_parts_of_the_first(
    make_model: MakeModel, tmp_path: Path
) -> None:
    """Oracle: the first model, still readable after its copied index was replaced."""
    write_splat_file(tmp_path / "a.gltf", make_model(30, 1, 0))
    shutil.copy(tmp_path / "a.gltf", tmp_path / "b.gltf")
    write_splat_file(tmp_path / "b.gltf", make_model(40, 1, 1))
    assert len(read_splat_file(tmp_path / "a.gltf").splats) == 30
    assert len(read_splat_file(tmp_path / "b.gltf").splats) == 40

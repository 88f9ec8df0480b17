"""Models in several files that are replaced in place; oracle: the model that was there, or the new
one."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from gscore.errors import FormatError, GsError
from gscore.formats import files_of, parts, read_splat_file, read_splats, write_splat_file

from .conftest import MakeModel

NAMES = ("meta.json", "a.gltf", "a.spz.gltf")


@pytest.mark.parametrize("name", NAMES)
def test_one_model_replaces_another(make_model: MakeModel, tmp_path: Path, name: str) -> None:
    """Oracle: the last model, the files that its index names, and none of the ones before."""
    (tmp_path / "notes.webp").write_bytes(b"mine")
    (tmp_path / "b.bin").write_bytes(b"mine")
    for seed in range(3):
        written = write_splat_file(tmp_path / name, make_model(300 + seed, 1, seed))
        found = read_splat_file(tmp_path / name)
        assert len(found.splats) == 300 + seed
        files = files_of(tmp_path / name)
        assert {*tmp_path.iterdir()} == {*files, tmp_path / "notes.webp", tmp_path / "b.bin"}
        size = sum(file.stat().st_size for file in files)
        assert size == written.storage_bytes == found.storage_bytes
    assert (tmp_path / "notes.webp").read_bytes() == (tmp_path / "b.bin").read_bytes() == b"mine"


@pytest.mark.parametrize("name", NAMES)
def test_a_write_that_fails_leaves_the_old_model(
    make_model: MakeModel, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the old model's means and files, however many parts fit on the disk before it was
    full."""
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
    """Ends a write as a kill does: nothing is tidied up after it but by `finally`."""


@pytest.mark.parametrize("name", NAMES)
def test_a_killed_write_leaves_one_whole_model(
    make_model: MakeModel, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the old model, whichever rename the program was killed at, and the new one once it
    was not."""
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
    write_splat_file(tmp_path / name, make_model(301, 1, 2))
    assert len(read_splats(tmp_path / name)) == 301


@pytest.mark.parametrize("name", NAMES)
def test_exchanged_parts_are_refused(make_model: MakeModel, tmp_path: Path, name: str) -> None:
    """Oracle: the name of each part that was taken from another model of as many splats; files
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
    that an index names outside of its folder."""
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
    """Oracle: the first model, which is still read after its copied index was replaced."""
    write_splat_file(tmp_path / "a.gltf", make_model(30, 1, 0))
    shutil.copy(tmp_path / "a.gltf", tmp_path / "b.gltf")
    write_splat_file(tmp_path / "b.gltf", make_model(40, 1, 1))
    assert len(read_splat_file(tmp_path / "a.gltf").splats) == 30
    assert len(read_splat_file(tmp_path / "b.gltf").splats) == 40

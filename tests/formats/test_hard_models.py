"""Models that are hard to pack, and files beside the one that is written; oracle: the models."""

import json
from pathlib import Path

import numpy as np
import pytest

from gscore.commands import main
from gscore.errors import ConfigError
from gscore.formats import read_splat_file, write_splat_file
from gscore.io.ply import write_splats

from .conftest import MakeModel


def test_colours_that_are_all_zero_come_back_from_zstd(
    make_model: MakeModel, tmp_path: Path
) -> None:
    """Oracle: the splats; zstd packs their spherical harmonics 30,000 times."""
    pytest.importorskip("zstandard")
    plain = make_model(200_000)
    plain.shN[:] = 0
    write_splat_file(tmp_path / "a.spz", plain, spz_version=4)
    found = read_splat_file(tmp_path / "a.spz").splats
    assert len(found) == 200_000 and not found.shN.any()


@pytest.mark.parametrize("name", ["a.compressed.ply", "a.sog", "a.spz", "a.splat", "a.glb"])
def test_a_number_that_is_not_finite_takes_no_neighbours(
    make_model: MakeModel, tmp_path: Path, name: str
) -> None:
    """Oracle: the other splats, and a note."""
    spoilt = make_model(1000)
    spoilt.means[7, 1] = np.nan
    spoilt.quats[300] = 0
    told = write_splat_file(tmp_path / name, spoilt)
    assert any("2 of 1,000 splats" in note for note in told.notes)
    found = read_splat_file(tmp_path / name).splats
    assert len(found) == 998
    middle = np.delete(spoilt.means, [7, 300], axis=0).mean(axis=0)
    assert np.abs(found.means.mean(axis=0) - middle).max() < 0.01


def test_the_mark_of_packed_splats_counts(make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: SPZ's own flag, in a glTF file without marks of gscore."""
    write_splat_file(tmp_path / "a.spz.gltf", make_model(1000), antialiased=True)
    content = json.loads((tmp_path / "a.spz.gltf").read_text())
    del content["meshes"][0]["primitives"][0]["extras"]
    (tmp_path / "a.spz.gltf").write_text(json.dumps(content))
    assert read_splat_file(tmp_path / "a.spz.gltf").antialiased


def test_no_file_beside_is_replaced(
    make_model: MakeModel, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: what stood there; and an unpacked SOG that is read stays as it is."""
    write_splats(tmp_path / "a.ply", make_model(1000))
    (tmp_path / "scan.bin").write_bytes(b"precious")
    assert main(["convert", str(tmp_path / "a.ply"), str(tmp_path / "scan.gltf")]) == 2
    assert "scan.bin" in capsys.readouterr().err
    assert (tmp_path / "scan.bin").read_bytes() == b"precious"
    folder = tmp_path / "sog"
    write_splat_file(folder / "meta.json", make_model(1000))
    again = ["convert", str(folder), str(folder / "meta.json"), "--count", "9", "--overwrite"]
    assert main(again) == 2
    assert "is what is read" in capsys.readouterr().err
    assert len(read_splat_file(folder).splats) == 1000


def test_names_that_only_end_like_one(make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: two unpacked SOGs in one folder would share their textures."""
    with pytest.raises(ConfigError, match="no format"):
        write_splat_file(tmp_path / "a_meta.json", make_model(1000))

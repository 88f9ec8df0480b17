"""Models that are hard to pack, and files beside the one that is written; oracle: the models."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from gscore.commands import main
from gscore.errors import ConfigError
from gscore.formats import read_splat_file, write_splat_file
from gscore.importance import importance_of
from gscore.io.ply.splats import write_splats

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


@pytest.mark.parametrize("far", [1e3, 1e6])
@pytest.mark.parametrize(("count", "beside"), [(2 * 256 + 3, 0), (4 * 256 + 200, 197)])
def test_far_splats_move_few_others_in_a_compressed_ply(
    make_model: MakeModel, tmp_path: Path, far: float, count: int, beside: int
) -> None:
    """Oracle: the displacements against the note; what moves are the least visible of the splats
    that fill no whole chunks."""
    model = make_model(count)
    model.means[:3] += np.float32(far) * np.array([[1], [-1], [2]], np.float32)
    told = write_splat_file(tmp_path / "a.compressed.ply", model)
    found = read_splat_file(tmp_path / "a.compressed.ply").splats
    near = model.subset(np.arange(3, count))
    moved = KDTree(found.means).query(near.means)[0]
    assert np.count_nonzero(moved > 0.02) <= beside
    importance = importance_of(near)
    assert moved[importance > np.sort(importance)[beside]].max() < 0.02
    stated = [note for note in told.notes if "share their chunk" in note]
    assert len(stated) == bool(beside)
    if stated:
        most = float(re.search(r"by up to (\S+) units", stated[0])[1])
        assert stated[0].startswith(f"{beside} splats") and moved.max() <= 1.8 * most < far / 100


def test_compressed_plys_of_ordinary_models_need_no_note(
    make_model: MakeModel, tmp_path: Path
) -> None:
    """Oracle: no note, at any number of splats; places within a thousandth of the model's side."""
    for count in (1, 2, 100, 256, 257, 3000):
        model = make_model(count)
        assert not write_splat_file(tmp_path / "a.compressed.ply", model).notes
        found = read_splat_file(tmp_path / "a.compressed.ply").splats
        side = np.ptp(model.means, axis=0).max()
        assert KDTree(found.means).query(model.means)[0].max() <= max(side / 1000, 1e-6)

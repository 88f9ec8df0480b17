"""Models that are hard to pack, and files next to the output; oracle: the models."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from gscore.commands import main
from gscore.errors import ConfigError
from gscore.formats import read_splat_file, write_splat_file
from gscore.importance import importance_of
from gscore.io.ply.splats import write_splats
from gscore.splats import Splats

from .conftest import Draw, MakeModel


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
    reported = write_splat_file(tmp_path / name, spoilt)
    assert any("2 of 1,000 splats" in note for note in reported.notes)
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
    """Oracle: the existing files; an unpacked SOG that is read is unchanged."""
    write_splats(tmp_path / "a.ply", make_model(1000))
    (tmp_path / "scan.bin").write_bytes(b"precious")
    assert main(["convert", str(tmp_path / "a.ply"), str(tmp_path / "scan.gltf")]) == 2
    assert "scan.bin" in capsys.readouterr().err
    assert (tmp_path / "scan.bin").read_bytes() == b"precious"
    folder = tmp_path / "sog"
    write_splat_file(folder / "meta.json", make_model(1000))
    again = ["convert", str(folder), str(folder / "meta.json"), "--count", "9", "--overwrite"]
    assert main(again) == 2
    assert "is an input file" in capsys.readouterr().err
    assert len(read_splat_file(folder).splats) == 1000


def test_names_that_only_end_like_one(make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: two unpacked SOGs in one folder, which would share their textures."""
    with pytest.raises(ConfigError, match="no format"):
        write_splat_file(tmp_path / "a_meta.json", make_model(1000))


@pytest.mark.parametrize("far", [1e3, 1e6])
@pytest.mark.parametrize(("count", "beside"), [(2 * 256 + 3, 0), (4 * 256 + 200, 197)])
def test_far_splats_move_few_others_in_a_compressed_ply(
    make_model: MakeModel, tmp_path: Path, far: float, count: int, beside: int
) -> None:
    """Oracle: the splats: near ones within a hundredth of their distances, those that fill whole
    chunks closer; a note where far ones are moved nearer."""
    model = make_model(count)
    model.means[:3] += np.float32(far) * np.array([[1], [-1], [2]], np.float32)
    reported = write_splat_file(tmp_path / "a.compressed.ply", model)
    found = read_splat_file(tmp_path / "a.compressed.ply").splats
    near = model.subset(np.arange(3, count))
    moved = KDTree(found.means).query(near.means)[0]
    assert moved.max() < 0.01 and np.count_nonzero(moved > 0.003) <= beside
    importance = importance_of(near)
    assert moved[importance > np.sort(importance)[beside]].max() < 0.003
    away = np.abs(found.means - np.median(near.means, axis=0)).max(axis=1)
    assert np.count_nonzero(away > 4) == 3
    stated = [note for note in reported.notes if "share their chunk" in note]
    assert len(stated) == bool(beside) == (away.max() < far / 2)
    assert all("3 splats up to" in note for note in stated)


def _dull(model: Splats) -> Splats:
    """The model with colours and coefficients that all formats hold."""
    model.sh0[:] = np.clip(model.sh0, -1.7, 1.7)
    return model


@pytest.mark.parametrize("side", [0.001, 1.0, 1000.0])
@pytest.mark.parametrize("far", [1e7, 1e30])
@pytest.mark.parametrize(
    "name", ["a.spz", "a.sog", "a.compressed.ply", "a.splat", "a.spz.glb", "a.glb", "a.ply"]
)
def test_one_far_splat_makes_no_other_coarse(
    make_model: MakeModel, tmp_path: Path, name: str, far: float, side: float
) -> None:
    """Oracle: the model: all others within a hundredth of their distances, the median within a
    thousandth; the far one keeps its direction, and a note names it where it is moved."""
    model = _dull(make_model(2000, 0))
    model.means[:] *= side
    model.scales[:] += np.log(side)
    model.means[7] = np.array([far, -far, far / 2], np.float32)
    reported = write_splat_file(tmp_path / name, model)
    found = read_splat_file(tmp_path / name).splats
    near = np.delete(model.means, 7, axis=0)
    middle = np.median(near, axis=0)
    moved = KDTree(found.means.astype(np.float64) / side).query(near / side)[0]
    assert moved.max() < 0.005 and np.median(moved) < 0.001
    there = found.means[np.abs(found.means - middle).max(axis=1).argmax()] - middle
    np.testing.assert_allclose(there / there[0], [1, -1, 0.5], atol=0.02)
    assert there[0] > 4 * side
    exact = name in ("a.splat", "a.glb", "a.ply")
    assert ("1 splat up to" in " ".join(reported.notes)) == (not exact)
    assert bool(np.isclose(there[0], far, rtol=1e-3)) == exact


@pytest.mark.parametrize("name", ["a.spz", "a.sog"])
def test_splats_of_a_tenth_are_never_moved(
    make_model: MakeModel, tmp_path: Path, name: str
) -> None:
    """Oracle: the directions and distances of a sky of far splats, which are no strays; the note
    states the step of positions."""
    model = _dull(make_model(1000, 0))
    sky = model.means[::5] / np.linalg.norm(model.means[::5], axis=1, keepdims=True)
    model.means[::5] = sky * np.float32(1e6)
    reported = write_splat_file(tmp_path / name, model)
    found = read_splat_file(tmp_path / name).splats
    assert KDTree(found.means).query(model.means[::5])[0].max() < 1e3
    assert any("is coarse for splats" in note for note in reported.notes)


@pytest.mark.parametrize("name", ["a.spz", "a.sog"])
def test_a_far_splat_looks_the_same_from_the_middle(
    make_model: MakeModel, draw: Draw, tmp_path: Path, name: str
) -> None:
    """Oracle: the picture of the written model, by a camera off its middle."""
    model = _dull(make_model(200, 0))
    model.means[7] = 1e5, 3e4, 6e5
    model.scales[7], model.opacities[7] = np.log(3e4), 4
    write_splat_file(tmp_path / name, model)
    found = read_splat_file(tmp_path / name).splats
    small = np.abs(found.means - np.median(model.means, axis=0)).max(axis=1) > 10
    assert small.sum() == 1 and found.scales[small].max() < 6
    assert np.abs(draw(model) - draw(found)).mean() < 0.01


@pytest.mark.parametrize("name", ["a.sog", "a.compressed.ply"])
@pytest.mark.parametrize("field", ["sh0", "shN", "scales"])
def test_one_extreme_number_makes_no_other_coarse(
    make_model: MakeModel, tmp_path: Path, name: str, field: str
) -> None:
    """Oracle: that number of all other splats, as close as in a file without the extreme one."""
    model = _dull(make_model(2000))
    middle = []
    for value in (0.0, 1e6):
        getattr(model, field)[7].flat[0] = value
        write_splat_file(tmp_path / name, model)
        found = read_splat_file(tmp_path / name).splats
        at = KDTree(found.means).query(model.means)[1]
        off = np.abs(getattr(found, field)[at] - getattr(model, field)).reshape(2000, -1)
        middle.append(np.quantile(np.delete(off.max(axis=1), 7), (0.5, 0.95)))
    assert (middle[1] < 2 * middle[0] + 0.01).all()


def test_the_bounds_of_a_packed_gltf_hold_what_it_holds(
    make_model: MakeModel, tmp_path: Path
) -> None:
    """Oracle: positions read back, after a half turn; a far splat is moved."""
    model = _dull(make_model(500, 0))
    model.means[7] = 1e7
    write_splat_file(tmp_path / "a.spz.gltf", model)
    content = json.loads((tmp_path / "a.spz.gltf").read_text())
    found = read_splat_file(tmp_path / "a.spz.gltf").splats.means * [-1, -1, 1]
    position = content["accessors"][content["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    np.testing.assert_allclose(position["min"], found.min(axis=0), atol=1e-3)
    np.testing.assert_allclose(position["max"], found.max(axis=0), atol=1e-3)


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


WRITTEN = ["a.compressed.ply", "a.sog", "a.spz", "a.splat", "a.glb", "a.spz.glb", "a.usda"]


@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.parametrize("power", [-135, -70, 70, 125])
@pytest.mark.filterwarnings("error")
def test_quaternions_of_any_length_turn_alike(
    make_model: MakeModel, tmp_path: Path, name: str, power: int
) -> None:
    """Oracle: the file of the same rotations at lengths about 1, of which a power of two takes no
    digit; squares of the others are out of float32's range."""
    if "usd" in name:
        pytest.importorskip("pxr")
    model = make_model(300)
    model.quats[:] = np.round(model.quats * 256) / 256  # few digits
    long = replace(model, quats=np.ldexp(model.quats, power))
    assert np.array_equal(np.ldexp(long.quats, -power), model.quats)
    (tmp_path / "long").mkdir()
    write_splat_file(tmp_path / name, model)
    write_splat_file(tmp_path / "long" / name, long)
    assert (tmp_path / "long" / name).read_bytes() == (tmp_path / name).read_bytes()


@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.parametrize("part", ["means", "scales", "opacities", "sh0", "shN"])
@pytest.mark.filterwarnings("error")
def test_numbers_at_the_ends_of_float32_are_written(
    make_model: MakeModel, tmp_path: Path, name: str, part: str
) -> None:
    """Oracle: no warning of numpy, and as many splats as were written."""
    if "usd" in name:
        pytest.importorskip("pxr")
    model = make_model(300)
    values = getattr(model, part).reshape(300, -1)
    values[::50], values[1::50] = 3e38, -3e38
    write_splat_file(tmp_path / name, model)
    assert len(read_splat_file(tmp_path / name).splats) == 300

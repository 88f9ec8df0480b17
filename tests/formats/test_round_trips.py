"""Every format written and read again: the values that survive, and the notes on the loss of the
rest."""

import json
from dataclasses import fields, replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest

import gscore
from gscore.errors import ConfigError
from gscore.formats import FORMATS, is_antialiased, read_splat_file, write_splat_file
from gscore.splats import Splats, cut_degree

from .conftest import Draw, MakeModel

WRITTEN = {
    "a.ply": "ply",
    "a.compressed.ply": "compressed-ply",
    "a.splat": "splat",
    "a.spz": "spz",
    "a.sog": "sog",
    "unpacked/meta.json": "sog",
    "a.glb": "gltf",
    "a.gltf": "gltf",
    "a.spz.glb": "gltf",
    "a.spz.gltf": "gltf",
    "a.usdc": "usd",
}
"""File names, and the detected format of each."""
LEAST_DB = {"splat": 38.0}
"""PSNR of the render, where it is not 45."""
EXACT = ("ply", "gltf", "usd")


@pytest.fixture(params=WRITTEN)
def name(request: pytest.FixtureRequest) -> str:
    """The name of the output file."""
    if WRITTEN[request.param] == "usd":
        pytest.importorskip("pxr.UsdVol")
    return request.param


def _psnr(a: np.ndarray, b: np.ndarray) -> float:
    return -10 * np.log10(max(float(np.mean((a - b) ** 2)), 1e-20))


def _degree(name: str) -> int:
    return 0 if name == "a.splat" else 3


def test_the_render_survives(name: str, make_model: MakeModel, draw: Draw, tmp_path: Path) -> None:
    """Oracle: the render of the written model, of the degree that the format stores."""
    model = make_model(degree=_degree(name))
    written = write_splat_file(tmp_path / name, model)
    found = read_splat_file(tmp_path / name)
    assert found.format == WRITTEN[name] and len(found.splats) == len(model)
    assert found.splats.sh_degree == model.sh_degree and not found.notes
    assert written.storage_bytes == found.storage_bytes > 0
    assert _psnr(draw(model), draw(found.splats)) >= LEAST_DB.get(found.format, 45.0)


def test_directions_and_handedness_survive(
    name: str, make_model: MakeModel, tmp_path: Path
) -> None:
    """Oracle: one splat, rotated and of uneven colour, rendered from six sides."""
    most = next(f.most_degree for f in FORMATS if f.key == WRITTEN[name])
    one = make_model(1, most, seed=4)
    one = replace(
        one,
        scales=np.array([[-1.0, -2, -3]], np.float32),
        opacities=np.array([3.0], np.float32),
        shN=one.shN * 3,
    )
    write_splat_file(tmp_path / name, one)
    again = gscore.read_splats(tmp_path / name)
    K = np.array([[60.0, 0, 24], [0, 60, 24], [0, 0, 1]])
    for axis in range(3):
        for side in (-1.0, 1.0):
            view = _looking_along(axis, side, one.means[0].astype(np.float64))
            first, second = (gscore.render(s, K, view, 48, 48).rgb for s in (one, again))
            assert first.max() > 0.1
            assert _psnr(np.clip(first, 0, 1), np.clip(second, 0, 1)) > 38


def _looking_along(axis: int, side: float, at: np.ndarray) -> np.ndarray:
    forward = np.zeros(3)
    forward[axis] = side
    right = np.roll(forward, 1)
    view = np.eye(4)
    view[:3, :3] = [right, np.cross(forward, right), forward]
    view[:3, 3] = -view[:3, :3] @ at + [0, 0, 3]
    return view


@pytest.mark.parametrize("antialiased", [False, True])
def test_the_tag_survives(
    name: str, antialiased: bool, make_model: MakeModel, tmp_path: Path
) -> None:
    """Oracle: the written tag; a note from formats without a place for it."""
    written = write_splat_file(tmp_path / name, make_model(5, 0), antialiased=antialiased)
    kept = WRITTEN[name] != "splat"
    assert read_splat_file(tmp_path / name).antialiased == (antialiased and kept)
    reported = any("antialiasing" in note for note in written.notes)
    assert reported == (antialiased and not kept)
    assert is_antialiased(tmp_path / name) == (antialiased and kept)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_degrees(name: str, degree: int, make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: the requested degree, where the format stores it."""
    model = make_model(40, 3)
    write_splat_file(tmp_path / name, model, sh_degree=degree)
    found = gscore.read_splats(tmp_path / name)
    assert found.sh_degree == (0 if name == "a.splat" else degree)


def test_degree_4(name: str, make_model: MakeModel, draw: Draw, tmp_path: Path) -> None:
    """Oracle: renders of the written model, of degree 4 where the format has it; else a
    sentence."""
    model = make_model(degree=4)
    model.sh0[:] = np.clip(model.sh0, -1.7, 1.7)
    written = write_splat_file(tmp_path / name, model)
    found = read_splat_file(tmp_path / name)
    most = {"ply": 4, "spz": 4, "usd": 4, "splat": 0}.get(found.format, 3)
    assert found.splats.sh_degree == most and not found.notes
    assert sum("SH degree" in note for note in written.notes) == (most < 4)
    wanted = cut_degree(model, most)
    assert _psnr(draw(wanted), draw(found.splats)) >= LEAST_DB.get(found.format, 45.0)
    if most == 4:
        assert _psnr(draw(cut_degree(model, 3)), draw(found.splats)) < 40


def test_spz_4_of_degree_4(make_model: MakeModel, draw: Draw, tmp_path: Path) -> None:
    """Oracle: SPZ of version 3, with the same bytes in another packing."""
    model = make_model(300, 4)
    read = []
    for version in (3, 4):
        write_splat_file(tmp_path / "a.spz", model, spz_version=version)
        read.append(gscore.read_splats(tmp_path / "a.spz"))
    assert read[1].sh_degree == 4
    np.testing.assert_array_equal(read[0].shN, read[1].shN)


def test_lost_harmonics_are_reported(make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: the sentence, and none where there was no degree to lose."""
    model = make_model(5, 2)
    model.sh0[:] = np.clip(model.sh0, -1.7, 1.7)
    reported = write_splat_file(tmp_path / "a.splat", model).notes
    assert len(reported) == 1 and "SH degree 0" in reported[0]
    assert not write_splat_file(tmp_path / "a.splat", model, sh_degree=0).notes


def test_parameters_survive_exactly(name: str, make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: the arrays; those of formats with floats to their last bits."""
    if WRITTEN[name] not in EXACT or ".spz." in name:
        pytest.skip("quantised")
    model = make_model(300, 3)
    write_splat_file(tmp_path / name, model)
    found = gscore.read_splats(tmp_path / name)
    unit = model.quats / np.linalg.norm(model.quats, axis=1, keepdims=True)
    wanted = replace(model, quats=model.quats if name == "a.ply" else unit)
    for field in ("means", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(found, field), getattr(wanted, field), field)
    for field in ("quats", "scales", "opacities"):
        np.testing.assert_allclose(
            getattr(found, field), getattr(wanted, field), rtol=1e-5, atol=3e-6
        )


@pytest.mark.parametrize("count", [1, 255, 256, 257])
def test_any_number_of_splats(name: str, count: int, make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: the count."""
    model = make_model(count, 1)
    write_splat_file(tmp_path / name, model)
    assert len(gscore.read_splats(tmp_path / name)) == count


@pytest.mark.parametrize("count", [0, 3])
def test_no_splats_are_refused(
    name: str, count: int, make_model: MakeModel, tmp_path: Path
) -> None:
    """Oracle: one sentence that names the file, which is not made; for an empty model, and one of
    invisible splats."""
    model = make_model(count, 1)
    model.means[:] = np.nan
    with pytest.raises(ConfigError, match="no splat to write into"):
        write_splat_file(tmp_path / name, model)
    assert not list(tmp_path.rglob("*.*"))


@pytest.mark.parametrize(("name", "ends"), [("a.spz", "-0.44 to 1.4"), ("a.splat", "0 to 1")])
def test_clamped_colors_are_reported(
    name: str, ends: str, make_model: MakeModel, tmp_path: Path
) -> None:
    """Oracle: the coefficients that are read back changed; none of those within the range."""
    model = make_model(500, 0)
    model.sh0[:] = np.clip(model.sh0, -1.7, 1.7)
    assert not write_splat_file(tmp_path / name, model).notes
    model.sh0[3, 0, 1], model.sh0[400, 0, 2] = 6, -5
    (note,) = write_splat_file(tmp_path / name, model).notes
    assert "of 2 splats" in note and ends in note
    found = gscore.read_splats(tmp_path / name)
    assert np.count_nonzero(np.abs(found.sh0 - model.sh0).max(axis=(1, 2)) > 0.1) == 2


def test_twice_is_the_same(name: str, make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: a second round trip, without further rounding but by codebooks."""
    write_splat_file(tmp_path / name, make_model(600, 1))
    first = gscore.read_splats(tmp_path / name)
    write_splat_file(tmp_path / name, first)
    second = gscore.read_splats(tmp_path / name)
    at = [np.lexsort(s.means.round(2).T) for s in (first, second)]
    for item in fields(Splats):
        a, b = getattr(first, item.name), getattr(second, item.name)
        if not a.size:
            continue
        if item.name == "quats":
            a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (a, b))
            a, b = (q * np.sign(q[:, :1] + 1e-9) for q in (a, b))
        assert np.median(np.abs(a[at[0]] - b[at[1]])) < 0.02, item.name


def test_content_decides_and_not_the_name(name: str, make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: the format of the file before it was renamed."""
    if name.endswith((".json", ".gltf")):
        pytest.skip("names files beside it")
    if name.endswith((".usda", ".usdc", ".usdz")):
        pytest.skip("the library goes by the name")
    write_splat_file(tmp_path / name, make_model(100, 1))
    moved = (tmp_path / name).rename(tmp_path / "some.bin")
    assert read_splat_file(moved).format == WRITTEN[name]


def test_every_format_is_tried_here() -> None:
    """Oracle: FORMATS."""
    written = {one.key for one in FORMATS if one.write}
    assert written == {*WRITTEN.values(), "gltf-spz"}


@pytest.mark.parametrize("ending", [".obj", ".ksplat", ""])
def test_endings_that_are_not_written(ending: str, make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: a ConfigError that lists the endings; no files."""
    with pytest.raises(ConfigError, match=r"\.spz"):
        write_splat_file(tmp_path / f"a{ending}", make_model(5))
    assert not list(tmp_path.iterdir())


def test_an_unpacked_sog_is_its_folder(make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: the model read by the name of the folder, and by that of its meta.json."""
    write_splat_file(tmp_path / "deep" / "meta.json", make_model(50, 1))
    by_folder = read_splat_file(tmp_path / "deep")
    by_file = read_splat_file(tmp_path / "deep" / "meta.json")
    assert len(by_folder.splats) == len(by_file.splats) == 50
    assert by_folder.storage_bytes == by_file.storage_bytes


@pytest.mark.parametrize("name", ["a.usda", "a.usdz", "a.usd"])
def test_other_names_of_usd(name: str, make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: the written positions, in text, in a package, in the binary form."""
    pytest.importorskip("pxr.UsdVol")
    model = make_model(20, 1)
    write_splat_file(tmp_path / name, model)
    found = gscore.read_splats(tmp_path / name)
    np.testing.assert_allclose(found.means, model.means, rtol=1e-6)


@pytest.mark.parametrize("name", ["two words.gltf", "100% grün#1.gltf", "a%20b.gltf"])
def test_names_that_are_no_uris(name: str, make_model: MakeModel, tmp_path: Path) -> None:
    """Oracle: the model read again, with a URI without spaces for its buffer."""
    write_splat_file(tmp_path / name, make_model(20, 0))
    uri = json.loads((tmp_path / name).read_text())["buffers"][0]["uri"]
    assert uri.isascii() and " " not in uri and unquote(uri) == name.replace(".gltf", ".bin")
    assert len(gscore.read_splats(tmp_path / name)) == 20


def test_spz_of_version_4(make_model: MakeModel, draw: Draw, tmp_path: Path) -> None:
    """Oracle: the same model as version 3, bit for bit; other versions are refused."""
    model = make_model()
    for version in (3, 4):
        write_splat_file(tmp_path / f"{version}.spz", model, spz_version=version)
    third, fourth = (read_splat_file(tmp_path / f"{v}.spz") for v in (3, 4))
    assert (third.layout, fourth.layout) == ("SPZ 3", "SPZ 4")
    for item in fields(Splats):
        np.testing.assert_array_equal(
            getattr(third.splats, item.name), getattr(fourth.splats, item.name)
        )
    with pytest.raises(ConfigError, match="version 3 or 4"):
        write_splat_file(tmp_path / "5.spz", model, spz_version=5)

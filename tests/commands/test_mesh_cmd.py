"""gscore mesh: a mesh of a run. Oracles: the shape of the splats, the JSON, the files."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gscore.config import DataConfig
from gscore.config_file import config_json, load_config
from gscore.formats import write_splat_file
from gscore.io.cameras_json import write_cameras
from gscore.io.images.png import write_png
from gscore.io.images.read_image import read_image
from gscore.io.mesh.files import read_mesh
from gscore.io.region_file import write_region
from tests.mesh.shapes import RADIUS, around, sphere

SMALL = ("--voxel", 0.08, "--threads", 1)


@pytest.fixture
def ball(tmp_path):
    """A folder with splats of a sphere and cameras around it."""
    folder = tmp_path / "ball"
    folder.mkdir()
    write_splat_file(folder / "point_cloud.ply", sphere(3000))
    write_cameras(folder / "cameras.json", around(16, size=90))
    return folder


def test_a_mesh_of_a_run(gscore, ball):
    """Oracle: the radius; the JSON's figures are those of the file; no progress on stdout."""
    code, out, err = gscore("mesh", ball, *SMALL, "--json")
    assert code == 0, err
    facts = json.loads(out)
    found = read_mesh(facts["path"])
    assert facts["path"] == str(ball / "mesh.ply")
    assert (len(found.vertices), len(found.triangles)) == (facts["vertices"], facts["triangles"])
    assert np.abs(np.linalg.norm(found.vertices, axis=1) - RADIUS).max() < 0.08
    assert (facts["views"], facts["voxel"], facts["mask_mode"]) == (16, 0.08, "none")
    assert "16 views; voxels of 0.08 world units" in err and " kB" in err
    np.testing.assert_allclose(facts["high"], found.vertices.max(axis=0))


def test_reduction_region_and_box(gscore, ball, tmp_path):
    """Oracle: the requested number of triangles; a box given in two ways."""
    box = ("--box", -2, -2, 0, 2, 2, 2)
    output = tmp_path / "half.obj"
    code, out, _ = gscore("mesh", ball, *SMALL, *box, "-o", output, "--quiet", "--holes", "open")
    assert (code, out) == (0, "")
    matrix = np.diag([2.0, 2.0, 1.0, 1.0])
    matrix[2, 3] = 1
    write_region(tmp_path / "region.json", matrix)
    options = ("--region", tmp_path / "region.json", "--holes", "open")
    code, _, _ = gscore("mesh", ball, *SMALL, *options, "-o", tmp_path / "same.obj")
    assert code == 0
    assert output.read_bytes() == (tmp_path / "same.obj").read_bytes()
    assert read_mesh(output).vertices[:, 2].min() > -0.08
    code, out, _ = gscore("mesh", ball, *SMALL, "--triangles", 300, "-o", tmp_path / "a.glb")
    assert code == 0 and "triangles from 16 views" in " ".join(out.split())


def test_events_of_a_mesh(gscore, ball):
    """Oracle: the protocol: the plan comes before the fusion, the result at the end."""
    code, out, _ = gscore("mesh", ball, *SMALL, "--events", "jsonl", "--between")
    assert code == 0
    events = [json.loads(line) for line in out.splitlines()]
    kinds = [event["event"] for event in events]
    phases = list(dict.fromkeys(event.get("phase") for event in events))
    assert kinds[-1] == "mesh" and events[-1]["path"] == str(ball / "mesh.ply")
    assert [p for p in phases if p] == [
        *("reading", "measuring", "looking for surfaces", "fusing", "contouring", "cleaning"),
        *("closing holes", "smoothing", "writing"),
    ]
    plan = events[kinds.index("mesh_plan")]
    assert plan["views"] > 16 and plan["volume_bytes"] > 0


def test_masks_of_the_capture_are_used(gscore, run_folder, capture, tmp_path):
    """Oracle: masks that hide the left third leave less, and those that hide all leave nothing; a
    run whose capture is gone has a warning instead."""
    run = run_folder()
    code, out, err = gscore("mesh", run, "--threads", 1, "--json", "--min-part", 0)
    assert code == 0, err
    assert json.loads(out)["mask_mode"] == "none" and json.loads(out)["views"] == 7
    whole = json.loads(out)["vertices"]
    data, train = load_config(run / "config.json")
    masked = tmp_path / "masked"
    shutil.copytree(capture, masked)
    photos = sorted((masked / "images").iterdir())
    mask = np.full(read_image(photos[0]).shape[:2], 255, np.uint8)
    for hidden in (mask.shape[1] // 3, mask.shape[1]):
        mask[:, :hidden] = 0
        for photo in photos:
            write_png(masked / "masks" / photo.name, np.repeat(mask[..., None], 3, axis=2))
        changed = replace(data, source=masked, masks="masks", mask_mode="composite")
        (run / "config.json").write_text(config_json(changed, train))
        options = ("--threads", 1, "--json", "--min-part", 0, "-o", tmp_path / f"{hidden}.ply")
        code, out, err = gscore("mesh", run, *options)
        if hidden < mask.shape[1]:
            assert code == 0 and json.loads(out)["mask_mode"] == "composite"
            assert 0 < json.loads(out)["vertices"] < 0.9 * whole
        else:
            assert code != 0 and "the masks" in " ".join(err.split())
    gone = DataConfig(source=capture / "gone", masks="masks")
    (run / "config.json").write_text(config_json(gone, train))
    code, out, err = gscore("mesh", run, "--threads", 1, "--json", "--min-part", 0)
    assert code == 0, err
    assert "no longer exists, so masks are not used" in " ".join(err.split())
    assert data.source != gone.source


def test_a_texture_of_the_photos(gscore, run_folder, tmp_path):
    """Oracle: the files beside the OBJ; cameras alone have no photos."""
    pytest.importorskip("xatlas")
    run = run_folder()
    options = ("--threads", 1, "--min-part", 0, "--texture", 64, "--triangles", 500)
    code, _, err = gscore("mesh", run, *options, "-o", tmp_path / "a.obj")
    assert code == 0, err
    assert sorted(path.name for path in tmp_path.glob("a.*")) == ["a.mtl", "a.obj", "a.png"]
    cameras = ("-s", run / "cameras.json")
    code, _, err = gscore("mesh", run, *options, *cameras, "-o", tmp_path / "b.glb")
    assert code == 2 and "needs the photos" in " ".join(err.split())
    code, _, err = gscore("mesh", run, *options, "-o", tmp_path / "a.ply")
    assert code == 2 and "a PLY has no texture" in " ".join(err.split())


def test_bad_input_of_a_mesh(gscore, ball, tmp_path):
    """Oracle: exit code 2 and a sentence, before any work, and no file."""
    other = tmp_path / "other.obj"
    other.write_text("v 0 0 0\n")
    for options, words in (
        (("-o", tmp_path / "a.stl"), ".ply, .obj, .glb"),
        (("-o", ball / "point_cloud.ply"), "the model itself"),
        (("-o", other), "--overwrite"),
        (("--voxel", 0), "--voxel must be above 0"),
        (("--box", 1, 1, 1, 0, 0, 0), "lower corner first"),
        (("--region", tmp_path / "none.json"), "none.json"),
        (("--triangles", 1), "--triangles must be at least 4"),
        (("--memory", 1e-6, "--voxel", 0.01), "--voxel 0.01 is too small"),
    ):
        code, _, err = gscore("mesh", ball, "--threads", 1, *options)
        assert code == 2, options
        assert words in " ".join(err.split())
    assert not (ball / "mesh.ply").exists()


def test_a_missing_package_is_named(gscore, ball, monkeypatch):
    """Oracle: the sentence of other verbs."""
    monkeypatch.setitem(__import__("sys").modules, "skimage.measure", None)
    code, _, err = gscore("mesh", ball, *SMALL)
    assert code == 2
    assert 'pip install "gscore[mesh]"' in " ".join(err.split())


def test_a_mesh_has_the_coordinates_of_a_far_capture(gscore, tmp_path):
    """Oracle: the sphere around its origin, to a millimetre, in a region given there too."""
    origin = np.array([412345.5, -5678901.25, 87.0])
    write_splat_file(tmp_path / "point_cloud.ply", sphere(3000), origin=origin)
    cameras = replace(around(16, size=90), origin=origin)
    write_cameras(tmp_path / "cameras.json", cameras)
    box = [*(origin - np.array([2, 2, 0])), *(origin + 2)]
    options = ("--holes", "open", "--box", *map(repr, map(float, box)))
    code, out, err = gscore("mesh", tmp_path, *SMALL, "--json", *options)
    assert code == 0, err
    vertices = read_mesh(json.loads(out)["path"]).vertices - origin
    assert np.abs(np.linalg.norm(vertices, axis=1) - RADIUS).max() < 0.08
    assert -0.08 < vertices[:, 2].min() < 0.08 and vertices[:, 2].max() > 0.9


def test_a_mesh_with_large_gaps_gets_a_warning(gscore, ball, tmp_path):
    """Oracle: the whole ball is seen; a shorter `--far` leaves caps, the nearest to each camera."""
    code, out, err = gscore("mesh", ball, *SMALL, "--json")
    assert code == 0 and json.loads(out)["covered"] > 0.95 and "covers only" not in err
    options = ("-o", tmp_path / "a.ply", "--far", 2.51, "--min-part", 0, "--voxel", 0.03)
    code, out, err = gscore("mesh", ball, *options, "--threads", 1, "--json")
    covered = json.loads(out)["covered"]
    assert code == 0 and 0 < covered < 0.6
    assert f"covers only {covered:.0%} of the surfaces" in " ".join(err.split())

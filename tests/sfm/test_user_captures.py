"""Captures as users bring them, from photos to cameras, compared with the known cameras.

A drone's photos with GPS are in `test_gps.py`.
"""

import re
import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gscore
from gscore.commands import main
from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.io.cameras_json import read_cameras_json
from gscore.io.colmap.folder import read_model
from gscore.scene import camera_centers
from tests import program_files
from tests.upright_photos import png, stored

from .conftest import STUDIO, cloud
from .test_panorama import panorama

Out = pytest.CaptureFixture[str]


def _errors(found: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far cameras are off after the similarity that fits them best.

    Args:
        found, true: [N, 4, 4], world to camera.

    Returns:
        Rotation [3, 3] of the found world to the true one, by the rotations of the cameras; errors
        of these [N], degrees, and of the centres [N], as a share of their extent.
    """
    u, _, vt = np.linalg.svd(np.einsum("nji,njk->ik", true[:, :3, :3], found[:, :3, :3]))
    rotation = u @ vt
    cosines = np.einsum("nij,jk,nik->n", true[:, :3, :3], rotation, found[:, :3, :3])
    turned = np.degrees(np.arccos(np.clip((cosines - 1) / 2, -1, 1)))
    a, b = camera_centers(found) @ rotation.T, camera_centers(true)
    a, b = a - np.median(a, axis=0), b - np.median(b, axis=0)
    off = np.linalg.norm(b - (a * b).sum() / (a**2).sum() * a, axis=1)
    return rotation, turned, off / np.linalg.norm(b, axis=1).max()


def _look_at(eye: np.ndarray) -> np.ndarray:
    """[4, 4] a level camera that faces the origin; z is up."""
    ahead = -eye / np.linalg.norm(eye)
    right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
    viewmat = np.eye(4)
    viewmat[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
    viewmat[:3, 3] = -viewmat[:3, :3] @ eye
    return viewmat


STORED = {
    1: [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    3: [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
    6: [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
    8: [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
}
"""By EXIF orientation (CIPA DC-008): from the axes of the shown picture to those of the stored."""


@pytest.mark.parametrize("held", [(6,), (3,), (8, 8, 1)])
def test_photos_of_a_phone_held_upright(held: tuple[int, ...], tmp_path: Path) -> None:
    """Oracle: the level cameras that rendered the pictures, turned as EXIF states, and the world's
    vertical."""
    K = np.array([[330.0, 0, 144], [0, 330.0, 192], [0, 0, 1]])
    eyes = [[3 * np.sin(0.1 * i), -3 * np.cos(0.1 * i), 1 + 0.1 * (i % 3)] for i in range(10)]
    true = np.stack([_look_at(np.array(eye)) for eye in eyes])
    (tmp_path / "walk").mkdir()
    for i, viewmat in enumerate(true):
        orientation = held[i % len(held)]
        size = (288, 384) if orientation > 4 else (384, 288)
        lens = K if orientation > 4 else K[[1, 0, 2]][:, [1, 0, 2]]
        shown = gscore.render(cloud(3), lens, viewmat, *size).rgb
        shown = (np.clip(shown, 0, 1) * 255).round().astype(np.uint8)
        pixels = np.ascontiguousarray(stored(shown, orientation))
        (tmp_path / f"walk/IMG_{i}.png").write_bytes(png(pixels, orientation))
        viewmat[:3] = np.array(STORED[orientation]) @ viewmat[:3]
    capture = tmp_path / "capture"
    asked = ["--focal-length", "330", "--quiet"]
    assert main(["sfm", str(tmp_path / "walk"), "-o", str(capture), *asked]) == 0
    cameras = load_dataset(DataConfig(source=capture)).scene.cameras
    assert len(cameras) == 10 and cameras.up is not None
    rotation, turned, off = _errors(cameras.viewmats, true)
    assert turned.max() < 5 and off.max() < 0.1
    assert np.degrees(np.arccos(np.clip(rotation @ cameras.up @ [0, 0, 1], -1, 1))) < 5


def _room() -> gscore.Splats:
    """Splats on the walls of a room and in it; y is down."""
    rng = np.random.default_rng(0)
    count = 5000
    means = rng.uniform(-1, 1, (count, 3))
    axis = rng.integers(0, 3, count)
    means[np.arange(count), axis] = np.sign(means[np.arange(count), axis])
    means *= [3, 1.5, 4]
    means[:1000] = rng.normal(size=(1000, 3)) * 0.35 + [1.2, 0.6, 0.5]
    return gscore.Splats(
        means=means.astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        scales=np.log(rng.uniform(0.03, 0.14, (count, 3))).astype(np.float32),
        opacities=np.full(count, 4.0, np.float32),
        sh0=rng.uniform(-1.7, 1.7, (count, 1, 3)).astype(np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )


@pytest.mark.slow
def test_panoramas_of_a_360_degree_camera(tmp_path: Path, capsys: Out) -> None:
    """Oracle: the places of rendered panoramas, and the turns of the views that the refusal's own
    command cuts out of them."""
    av = pytest.importorskip("av")
    (tmp_path / "walk").mkdir()
    (tmp_path / "views").mkdir()
    turns = 2 * np.pi * np.arange(5) / 5
    places = [
        np.array([0.4 * np.sin(t), 0.1 * (i % 2), 0.4 * np.cos(t)]) for i, t in enumerate(turns)
    ]
    photos = [panorama(place, _room(), 1024) for place in places]
    for i, photo in enumerate(photos):
        photo.save(tmp_path / f"walk/{i}.jpg", quality=95)
    assert main(["sfm", str(tmp_path / "walk"), "-o", str(tmp_path / "none"), "--quiet"]) == 2
    reported = " ".join(capsys.readouterr().err.replace("`", "").split())
    options = re.search(r"v360=(\S+?)yaw=0:w=1200:h=1200", reported)
    assert (
        options is not None and "--camera-model SIMPLE_PINHOLE and --focal-length 600" in reported
    )
    true = {}
    for i, photo in enumerate(photos):
        for yaw in range(-180, 180, 45):
            graph, turn, viewmat = av.filter.Graph(), np.radians(yaw), np.eye(4)
            source = graph.add_buffer(width=1024, height=512, format="rgb24", time_base=Fraction(1))
            cut = graph.add("v360", f"{options[1]}yaw={yaw}:w=400:h=400")
            sink = graph.add("buffersink")
            source.link_to(cut)
            cut.link_to(sink)
            graph.configure()
            graph.push(av.VideoFrame.from_ndarray(np.asarray(photo), format="rgb24"))
            name = f"{i}_{yaw + 180:03}.png"
            Image.fromarray(graph.pull().to_ndarray(format="rgb24")).save(tmp_path / "views" / name)
            viewmat[0, :3] = [np.cos(turn), 0, -np.sin(turn)]
            viewmat[2, :3] = [np.sin(turn), 0, np.cos(turn)]
            viewmat[:3, 3] = -viewmat[:3, :3] @ places[i]
            true[name] = viewmat
    asked = ["--camera-model", "SIMPLE_PINHOLE", "--focal-length", "200", "--quiet"]
    assert main(["sfm", str(tmp_path / "views"), "-o", str(tmp_path / "found"), *asked]) == 0
    images = read_model(tmp_path / "found").images
    assert len(images) >= 36
    found = np.stack([image.viewmat for image in images])
    known = np.stack([true[image.name] for image in images])
    _, turned, off = _errors(found, known)

    assert np.quantile(turned, 0.9) < 0.5 and np.quantile(off, 0.9) < 0.1


@pytest.mark.parametrize(
    ("write", "kind"),
    [
        (program_files.write_metashape, "Metashape XML"),
        (program_files.write_rs_csv, "RealityScan CSV"),
        (lambda at, rig: program_files.write_rs_xmp(at / "images", rig), "RealityScan XMP"),
    ],
)
def test_projects_of_metashape_and_realityscan(
    write: Callable, kind: str, tmp_path: Path, capsys: Out
) -> None:
    """Oracle: cameras of the bundled capture, exported by the program next to its photos, in the
    files of a training."""
    model = read_model(STUDIO)
    images = sorted(model.images, key=lambda image: image.name)[::5]
    true = np.stack([image.viewmat for image in images])
    focal = float(next(iter(model.cameras.values())).params[0])
    (tmp_path / "scan/images").mkdir(parents=True)
    for image in images:
        shutil.copy(STUDIO / "images" / image.name, tmp_path / "scan/images")
    names = tuple(image.name for image in images)
    rig = program_files.Rig(names, true[:, :3, :3], camera_centers(true), (480, 640), focal)
    write(tmp_path / "scan", rig)
    assert main(["info", str(tmp_path / "scan")]) == 0
    assert kind in capsys.readouterr().out
    arguments = ["--iterations", "2", "--preset", "preview", "-r", "8", "--quiet"]
    assert main(["train", str(tmp_path / "scan"), "-o", str(tmp_path / "run"), *arguments]) == 0
    found = read_cameras_json(tmp_path / "run/cameras.json")
    assert found.names == names
    np.testing.assert_allclose(found.Ks[:, 0, 0] / found.widths, focal / 480, rtol=1e-6)
    _, turned, off = _errors(found.viewmats, true)
    assert turned.max() < 1e-3 and off.max() < 1e-5

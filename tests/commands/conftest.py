"""A small capture whose photos are renders of known splats, and a run with these splats."""

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gscore.commands import main
from gscore.config import Background
from gscore.config_file import config_json, load_config
from gscore.io.colmap.folder import (
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    ColmapPoints,
    write_model,
)
from gscore.io.images.png import write_png
from gscore.io.ply.splats import write_splats
from gscore.raster.api import render
from gscore.scene import Cameras
from gscore.splats import Splats
from gscore.transforms import rotmat_to_quat
from tests.commands.small_bench import small  # noqa: F401
from tests.run_verb import gscore, hide_networks  # noqa: F401

WIDTH, HEIGHT, FOCAL, VIEWS = 48, 36, 45.0, 9
STEPS = 12


def _ring(count):
    """Cameras on a circle of radius 5 around the origin, 1 above it, facing it; z is up."""
    viewmats = []
    for angle in np.arange(count) / count * 2 * math.pi:
        eye = np.array([5 * math.cos(angle), 5 * math.sin(angle), 1.0])
        forward = -eye / np.linalg.norm(eye)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        viewmat = np.eye(4)
        viewmat[:3, :3], viewmat[:3, 3] = rotation, -rotation @ eye
        viewmats.append(viewmat)
    return np.stack(viewmats)


@pytest.fixture(scope="session")
def ring():
    """[9, 4, 4] viewmats on a circle."""
    return _ring(VIEWS)


@pytest.fixture(scope="session")
def splats():
    """Sixty coloured Gaussians within a ball of radius 1."""
    rng = np.random.default_rng(11)
    means = rng.normal(0, 0.5, (60, 3))
    return Splats(
        means=means.astype(np.float32),
        quats=rng.normal(size=(60, 4)).astype(np.float32),
        scales=rng.uniform(np.log(0.1), np.log(0.4), (60, 3)).astype(np.float32),
        opacities=rng.uniform(0, 3, 60).astype(np.float32),
        sh0=rng.uniform(-1.5, 1.5, (60, 1, 3)).astype(np.float32),
        shN=rng.normal(0, 0.1, (60, 3, 3)).astype(np.float32),
    )


@pytest.fixture(scope="session")
def cameras(ring):
    """The ring as Cameras named a_0.png ... a_8.png; the principal point is off the centre."""
    K = np.array([[FOCAL, 0, WIDTH / 2 + 1.5], [0, FOCAL + 2, HEIGHT / 2 - 1], [0, 0, 1]])
    return Cameras(
        viewmats=ring,
        Ks=np.tile(K, (VIEWS, 1, 1)),
        widths=np.full(VIEWS, WIDTH, np.int64),
        heights=np.full(VIEWS, HEIGHT, np.int64),
        names=tuple(f"a_{i}.png" for i in range(VIEWS)),
    )


@pytest.fixture(scope="session")
def picture(splats, cameras):
    """The true picture of view i, [H, W, 3] float."""

    def make(index, **options):
        K, viewmat = cameras.Ks[index], cameras.viewmats[index]
        return render(splats, K, viewmat, WIDTH, HEIGHT, **options)

    return make


@pytest.fixture(scope="session")
def capture(tmp_path_factory, cameras, splats, picture):
    """Folder with photos and a COLMAP model."""
    folder = tmp_path_factory.mktemp("capture")
    K = cameras.Ks[0]
    images = []
    for i, name in enumerate(cameras.names):
        rgb = np.clip(picture(i).rgb, 0, 1)
        write_png(folder / "images" / name, (rgb * 255 + 0.5).astype(np.uint8))
        images.append(
            ColmapImage(
                id=i + 1,
                name=name,
                camera_id=1,
                qvec=rotmat_to_quat(cameras.viewmats[i, :3, :3]),
                tvec=cameras.viewmats[i, :3, 3].copy(),
                xys=np.zeros((0, 2)),
                point3D_ids=np.zeros(0, np.int64),
            )
        )
    count = len(splats)
    model = ColmapModel(
        cameras={
            1: ColmapCamera(
                model="PINHOLE",
                width=WIDTH,
                height=HEIGHT,
                params=np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]]),
            )
        },
        images=images,
        points=ColmapPoints(
            ids=np.arange(1, count + 1),
            xyz=splats.means.astype(np.float64),
            rgb=np.full((count, 3), 128, np.uint8),
            error=np.full(count, 0.5),
            track_lengths=np.full(count, 2, np.int32),
        ),
    )
    write_model(model, folder / "sparse" / "0")
    return folder


@pytest.fixture(scope="session")
def trained(tmp_path_factory, capture):
    """A run of `STEPS` steps, as `gscore train` leaves it; views 0 and 8 are held out."""
    folder = tmp_path_factory.mktemp("trained") / "run"
    options = ["--preset", "draft", "--iterations", STEPS, "--eval", "--quiet"]
    with pytest.MonkeyPatch.context() as patch:
        hide_networks(patch)
        assert main([str(word) for word in ("train", capture, "-o", folder, *options)]) == 0
    return folder


@pytest.fixture
def run_folder(tmp_path, trained, splats):
    """A copy of that run with its splats replaced by those that the photos were rendered from."""

    def make(splats=splats, background=Background.AUTO):
        folder = tmp_path / "run"
        shutil.copytree(trained, folder)
        data, train = load_config(folder / "config.json")
        changed = config_json(data, replace(train, background=background))
        (folder / "config.json").write_text(changed)
        write_splats(folder / "point_cloud.ply", splats)
        exposure = folder / "exposure.json"  # these splats have the exposure of all photos
        neutral = dict.fromkeys(json.loads(exposure.read_text()), np.eye(3, 4).tolist())
        exposure.write_text(json.dumps(neutral))
        return folder

    return make

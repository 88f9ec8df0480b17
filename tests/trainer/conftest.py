"""A toy capture that takes milliseconds to train on, in memory and as a folder."""

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.depth.params import FILE
from gscore.io.colmap.folder import read_model, write_model
from gscore.io.colmap.model import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
from gscore.io.images.png import write_png
from gscore.raster.api import render
from gscore.splats import Splats
from gscore.stress.capture import SIZE, VIEWS, ToyPhotos, toy_photos, toy_splats
from gscore.transforms import rotmat_to_quat
from tests.engine.fake_engine import FakeEngine
from tests.isas import isa  # noqa: F401
from tests.marked_model import marked_model  # noqa: F401
from tests.run_verb import refused  # noqa: F401
from tests.trainer.short_run import DEEP_UNIT


@pytest.fixture(scope="session")
def photos() -> ToyPhotos:
    """The toy capture, all views for training. Do not change it."""
    return toy_photos()


@pytest.fixture
def make_photos() -> Callable[..., ToyPhotos]:
    """`toy_photos(seed, held_out=...)`."""
    return toy_photos


@pytest.fixture(scope="session")
def known_splats() -> Splats:
    """The splats that the toy capture was rendered from. Do not change them."""
    return toy_splats()


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The toy capture as a COLMAP folder. Do not change it."""
    root = tmp_path_factory.mktemp("capture")
    photos = toy_photos()
    cameras, cloud = photos.scene.cameras, photos.scene.points
    K = cameras.Ks[0]
    camera = ColmapCamera(
        model="PINHOLE",
        width=SIZE,
        height=SIZE,
        params=np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]]),
    )
    images = [
        ColmapImage(
            id=i + 1,
            name=cameras.names[i],
            camera_id=1,
            qvec=rotmat_to_quat(cameras.viewmats[i, :3, :3]),
            tvec=cameras.viewmats[i, :3, 3],
            xys=np.zeros((0, 2)),
            point3D_ids=np.zeros(0, np.int64),
        )
        for i in range(VIEWS)
    ]
    n = len(cloud)
    points = ColmapPoints(
        ids=np.arange(1, n + 1),
        xyz=cloud.points,
        rgb=cloud.colors,
        error=np.full(n, 0.5),
        track_lengths=np.zeros(n, np.int32),
    )
    write_model(ColmapModel(cameras={1: camera}, images=images, points=points), root / "sparse/0")
    for name, image in zip(cameras.names, photos.images, strict=True):
        write_png(root / "images" / name, image)
    return root


@pytest.fixture
def frames(capture: Path, tmp_path: Path) -> Path:
    """Three frames of the toy capture, each in a COLMAP world of its own."""
    root = tmp_path / "video"
    for number in (0, 5, 10):
        folder = root / f"{number:06d}"
        shutil.copytree(capture, folder)
        rng = np.random.default_rng(number)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turn *= np.linalg.det(turn)
        scale, shift = 1 + 0.1 * number, rng.normal(size=3)
        model = read_model(folder)
        images = []
        for image in model.images:
            viewmat = image.viewmat
            turned = viewmat[:3, :3] @ turn.T
            place = scale * turn @ (-viewmat[:3, :3].T @ viewmat[:3, 3]) + shift
            images.append(replace(image, qvec=rotmat_to_quat(turned), tvec=-turned @ place))
        points = replace(model.points, xyz=scale * model.points.xyz @ turn.T + shift)
        write_model(replace(model, images=images, points=points), folder / "sparse/0")
    return root


@pytest.fixture(scope="session")
def deep(capture: Path, known_splats: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The toy capture with its true inverse depth in depths/ and the scale of the maps. Do not
    change it."""
    root = tmp_path_factory.mktemp("deep") / "capture"
    shutil.copytree(capture, root)
    cameras = load_dataset(DataConfig(source=root)).scene.cameras
    params = {}
    for i, name in enumerate(cameras.names):
        view = render(known_splats, cameras.Ks[i], cameras.viewmats[i], 48, 48)
        assert view.inverse_depth is not None
        values = np.where(view.alpha > 0.95, view.inverse_depth, 0)
        assert values.max() < DEEP_UNIT
        write_png(
            root / "depths" / f"{Path(name).stem}.png",
            (values / DEEP_UNIT * 65536 + 0.5).astype(np.uint16),
        )
        params[Path(name).stem] = {"scale": DEEP_UNIT, "offset": 0.0}
    (root / "sparse" / "0" / FILE).write_text(json.dumps(params))
    return root


@pytest.fixture
def real_engine() -> None:
    """Trainings compute by the CPU engine, in a module whose other tests have `fake_engine`."""


@pytest.fixture
def fake_engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trainings compute by fake engines, for tests of all but their splats."""
    if "real_engine" in request.fixturenames:
        return
    monkeypatch.setattr("gscore.engine.opening.CpuEngine", lambda **_: FakeEngine())


@pytest.fixture(autouse=True)
def known_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pace of the reference machine, which is not measured."""
    monkeypatch.setattr("gscore.engine.cpu.engine.current_pace", lambda threads: 1.0)


@pytest.fixture(autouse=True)
def one_torch_thread() -> Iterator[None]:
    """One torch thread, as in a run."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True)
def no_lpips(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """No LPIPS network, because results must not depend on one that this machine may have."""
    if request.node.get_closest_marker("data") is None:
        for name in ("GSCORE_DATA", "GSCORE_LPIPS"):
            monkeypatch.delenv(name, raising=False)

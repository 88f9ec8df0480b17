"""Multi-view video in the layouts of PKU-DyMVHumans, on a small scenario rendered here.

The data set itself may not be redistributed. `make_case` writes its folders as its own scripts do:
every frame in a different COLMAP world, black points, soft mattes, fx unlike fy, test views twice.
"""

import json
import operator
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore.config import DataConfig
from gscore.datasets import load_dataset, read_capture
from gscore.datasets.capture import Capture
from gscore.datasets.frames import find_frames
from gscore.errors import ConfigError, DatasetError, FormatError, GsError
from gscore.io.colmap.folder import write_model
from gscore.io.colmap.model import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
from gscore.io.images.png import write_png
from gscore.io.images.read_image import read_image
from gscore.raster.api import render
from gscore.sh import rgb_to_sh0
from gscore.splats import Splats
from gscore.stress.capture import facing_origin
from gscore.transforms import opengl_from_viewmat, rotmat_to_quat, transform_splats

VIEWS, WIDTH, HEIGHT = 12, 64, 36
K = np.array([[60.0, 0, WIDTH / 2], [0, 63.6, HEIGHT / 2], [0, 0, 1]])
FRAMES = (0, 5, 10)
TEST = (0, 10)
"""Cameras that the NeuS2 and NGP files hold out."""


def viewmats() -> np.ndarray:
    """[VIEWS, 4, 4] true cameras, in a ring around the origin."""
    out = []
    for i in range(VIEWS):
        angle = 2 * np.pi * i / VIEWS
        center = np.array([3 * np.cos(angle), -0.5 + 0.1 * (i % 3), 3 * np.sin(angle)])
        out.append(facing_origin(center))
    return np.stack(out)


def splats_at(frame: int) -> Splats:
    """Blobs in the true world, half of which move."""
    rng = np.random.default_rng(4)
    means = rng.normal(size=(40, 3)) * 0.35
    means[:20] += [0.02 * frame, 0.0, 0.01 * frame]
    return Splats(
        means=means.astype(np.float32),
        quats=rng.normal(size=(40, 4)).astype(np.float32),
        scales=np.log(rng.uniform(0.08, 0.2, (40, 3))).astype(np.float32),
        opacities=np.full(40, 1.5, np.float32),
        sh0=rgb_to_sh0(rng.uniform(0.3, 1, (40, 1, 3))).astype(np.float32),
        shN=np.zeros((40, 0, 3), np.float32),
    )


def world_of(frame: int) -> np.ndarray:
    """[4, 4] the arbitrary similarity of SfM for a frame."""
    rng = np.random.default_rng(100 + frame)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    out = np.eye(4)
    out[:3, :3] = q * np.linalg.det(q) * rng.uniform(0.5, 3)
    out[:3, 3] = rng.normal(size=3) * 2
    return out


def moved(viewmat: np.ndarray, world: np.ndarray) -> np.ndarray:
    """The camera in the world after a similarity."""
    scale = np.cbrt(np.linalg.det(world[:3, :3]))
    out = viewmat @ np.linalg.inv(world)
    out[:3] *= scale
    return out


@dataclass
class Case:
    """A scenario on disk."""

    root: Path
    photos: dict[int, list[np.ndarray]]
    """[HEIGHT, WIDTH, 3] uint8 by frame and camera."""
    mattes: dict[int, list[np.ndarray]]
    """[HEIGHT, WIDTH] uint8 by frame and camera."""

    def write_all(self, layout: str) -> Path:
        """Write one layout."""
        for frame in FRAMES:
            getattr(self, f"_{layout}")(frame)
        return self.root

    def _pictures(self, folder: Path, pattern: str, pictures: list[np.ndarray], frame: int) -> None:
        for i, picture in enumerate(pictures):
            write_png(folder / pattern.format(c=i, f=frame), picture)

    def _rgba(self, frame: int) -> list[np.ndarray]:
        pairs = zip(self.photos[frame], self.mattes[frame], strict=True)
        return [np.dstack([photo, matte]) for photo, matte in pairs]

    def _data_COLMAP(self, frame: int) -> None:  # noqa: N802 - the folder's name
        folder = self.root / f"data_COLMAP/{frame:06d}"
        name = "image_c_{c:03d}_f_{f:06d}.png"
        self._pictures(folder / "images", name, self.photos[frame], frame)
        self._pictures(folder / "masks", name, self.mattes[frame], frame)
        write_model(self.model(frame), folder / "sparse")

    def model(self, frame: int, *, noise: float = 0.0) -> ColmapModel:
        """The SfM result of a frame."""
        world, rng = world_of(frame), np.random.default_rng(frame)
        focal = [K[0, 0] * (1 + 0.001 * frame), K[1, 1] * (1 + 0.001 * frame)]
        images = []
        for i, true in enumerate(viewmats()):
            viewmat = moved(true, world)
            images.append(
                ColmapImage(
                    id=i + 1,
                    name=f"image_c_{i:03d}_f_{frame:06d}.png",
                    camera_id=1,
                    qvec=rotmat_to_quat(viewmat[:3, :3]),
                    tvec=viewmat[:3, 3] + rng.normal(size=3) * noise,
                    xys=np.zeros((0, 2)),
                    point3D_ids=np.zeros(0, np.int64),
                )
            )
        points = transform_splats(splats_at(frame), world).means.astype(np.float64)
        n = len(points)
        return ColmapModel(
            cameras={
                1: ColmapCamera(
                    model="PINHOLE",
                    width=WIDTH,
                    height=HEIGHT,
                    params=np.array([*focal, K[0, 2], K[1, 2]]),
                )
            },
            images=images,
            points=ColmapPoints(
                ids=np.arange(1, n + 1),
                xyz=points,
                rgb=np.zeros((n, 3), np.uint8),
                error=np.ones(n),
                track_lengths=np.zeros(n, np.int32),
            ),
        )

    def write_cams(self, *, shrink: float = 1.0) -> None:
        """`cams`, made from frame 0."""
        for i, true in enumerate(viewmats()):
            rows = moved(true, world_of(0))
            text = "extrinsic\n" + "\n".join(" ".join(map(str, row)) + " " for row in rows)
            text += "\n\nintrinsic\n"
            matrix = np.diag([shrink, shrink, 1]) @ K
            text += "\n".join(" ".join(map(str, row)) + " " for row in matrix)
            path = self.root / f"cams/{i:08d}_cam.txt"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text + "\n\n0.5 0.01 192.0 4.5  # depth range and interval\n")

    def _per_frame(self, frame: int) -> None:
        self.write_cams()
        folder = self.root / f"per_frame/{frame:06d}"
        self._pictures(
            folder / "images", "image_c_{c:03d}_f_{f:06d}.png", self.photos[frame], frame
        )
        self._pictures(folder / "pha", "pha_c_{c:03d}_f_{f:06d}.png", self.mattes[frame], frame)
        self._pictures(folder / "rgba", "image_c_{c:03d}_f_{f:06d}.png", self._rgba(frame), frame)

    def _per_view(self, frame: int) -> None:
        self.write_cams()
        folder = self.root / "per_view"
        self._pictures(folder, "cam_{c}/images/{f:06d}.png", self.photos[frame], frame)
        self._pictures(folder, "cam_{c}/pha/{f:06d}.png", self.mattes[frame], frame)
        self._pictures(folder, "cam_{c}/com/{f:06d}.png", self._rgba(frame), frame)

    def _data_NeuS2(self, frame: int) -> None:  # noqa: N802
        root, name = self.root / "data_NeuS2", "image_c_{c:03d}_f_{f:06d}.png"
        self._pictures(root / f"images/{frame:06d}", name, self._rgba(frame), frame)
        intrinsic = np.eye(4)
        intrinsic[:3, :3] = K
        intrinsic[0, 1] = 1e-5  # the rounding of decomposed float32 matrices
        entries = [
            {
                "file_path": f"images/{frame:06d}/{name.format(c=i, f=frame)}",
                "transform_matrix": np.linalg.inv(moved(true, world_of(frame)))
                .astype(np.float32)
                .tolist(),
                "intrinsic_matrix": intrinsic.tolist(),
            }
            for i, true in enumerate(viewmats())
        ]
        test = [entries[i] for i in TEST]
        train = [entry for i, entry in enumerate(entries) if i not in TEST]
        head = {"w": WIDTH, "h": HEIGHT, "aabb_scale": 1.0, "scale": 0.5, "from_na": True}
        # The script that made the files appends all views to the list of test views.
        for place, frames in (("train", train), ("test", test), ("", test + entries)):
            path = root / place / f"transform_{frame:06d}.json"
            path.parent.mkdir(exist_ok=True)
            path.write_text(json.dumps(head | {"frames": frames}))

    def _data_ngp(self, frame: int) -> None:
        folder, name = self.root / f"data_ngp/{frame:06d}", "image_c_{c:03d}_f_{f:06d}.png"
        # The JSON says `image`; the README's tree has `images`.
        self._pictures(folder / "images", name, self._rgba(frame), frame)
        entries = [
            {
                "file_path": f"image/{name.format(c=i, f=frame)}",
                "transform_matrix": opengl_from_viewmat(moved(true, world_of(frame))).tolist(),
            }
            for i, true in enumerate(viewmats())
        ]
        head: dict[str, Any] = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
        head |= {"k1": 0, "k2": 0, "p1": 0, "p2": 0, "w": float(WIDTH), "h": float(HEIGHT)}
        test = [entries[i] for i in TEST]
        train = [entry for i, entry in enumerate(entries) if i not in TEST]
        for split, frames in (("train", train), ("val", test[:1]), ("test", test)):
            (folder / f"transform_{split}.json").write_text(json.dumps(head | {"frames": frames}))

    def _data_NeuS(self, frame: int) -> None:  # noqa: N802
        folder = self.root / f"data_NeuS/{frame:06d}"
        self._pictures(folder / "images", "{c:03d}.png", self.photos[frame], frame)
        self._pictures(folder / "mask", "{c:03d}.png", self.mattes[frame], frame)
        arrays = {}
        for i, true in enumerate(viewmats()):
            matrix = np.eye(4)
            matrix[:3] = (K @ moved(true, world_of(frame))[:3]) * (-2.5 if i % 2 else 1)
            arrays |= {f"world_mat_{i}": matrix, f"world_mat_inv_{i}": np.linalg.inv(matrix)}
            arrays[f"scale_mat_{i}"] = np.diag([0.5, 0.5, 0.5, 1])
        np.savez(folder / "cameras_sphere.npz", **arrays)


@pytest.fixture(scope="module")
def pictures() -> tuple[dict[int, list[np.ndarray]], dict[int, list[np.ndarray]]]:
    """Photos over a grey room and mattes, by frame and camera."""
    photos: dict[int, list[np.ndarray]] = {}
    mattes: dict[int, list[np.ndarray]] = {}
    for frame in FRAMES:
        photos[frame], mattes[frame] = [], []
        for viewmat in viewmats():
            view = render(splats_at(frame), K, viewmat, WIDTH, HEIGHT)
            photo = view.rgb + 0.2 * (1 - view.alpha[..., None])
            photos[frame].append((np.clip(photo, 0, 1) * 255 + 0.5).astype(np.uint8))
            mattes[frame].append((view.alpha * 255 + 0.5).astype(np.uint8))
    return photos, mattes


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, pictures: Any) -> Callable[[str], Path]:
    """A scenario with one layout, written once, because files synced to the disk are slow."""
    root = tmp_path_factory.mktemp("layouts")

    def write(layout: str) -> Path:
        folder = root / layout
        return folder if folder.exists() else Case(folder, *pictures).write_all(layout)

    return write


@pytest.fixture
def make_case(tmp_path: Path, pictures: Any, written: Callable[[str], Path]) -> Callable[..., Case]:
    """`make(*layouts)`."""

    def make(*layouts: str) -> Case:
        case = Case(tmp_path / "1080_Dance_Single_f01", *pictures)
        for layout in layouts:
            shutil.copytree(written(layout), case.root, dirs_exist_ok=True)
        return case

    return make


LAYOUTS = ("data_COLMAP", "per_frame", "per_view", "data_NeuS2", "data_ngp", "data_NeuS")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_true_cameras(make_case: Callable[..., Case], layout: str) -> None:
    """Oracle: the cameras that rendered the pictures, in the frame's world as written."""
    case = make_case(layout)
    capture = read_capture(DataConfig(source=case.root, frame=5))
    world = world_of(0 if layout.startswith("per_") else 5)  # `cams` is made from frame 0
    views = sorted(capture.views, key=lambda view: view.name)
    assert len(views) == VIEWS
    for view, true in zip(views, viewmats(), strict=True):
        np.testing.assert_allclose(view.viewmat, moved(true, world), atol=1e-5)
        focal = 1.005 if layout == "data_COLMAP" else 1.0
        wanted = K * [[focal, 1, 1], [1, focal, 1], [1, 1, 1]]
        np.testing.assert_allclose(view.camera.K, wanted, rtol=1e-6)
        assert (view.camera.width, view.camera.height) == (WIDTH, HEIGHT)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_photos_and_soft_mattes(
    make_case: Callable[..., Case], layout: str
) -> None:
    """Oracle: the written bytes; mattes are opacity, not ignored regions."""
    case = make_case(layout)
    dataset = load_dataset(DataConfig(source=case.root, frame=10, resolution=1))
    assert dataset.mask_mode == "composite"
    soft = 0
    for i in range(VIEWS):
        matte = dataset.mask(i)
        assert matte is not None
        np.testing.assert_array_equal(matte, case.mattes[10][i])
        np.testing.assert_array_equal(dataset.image(i), case.photos[10][i])
        soft += int(((matte > 20) & (matte < 235)).sum())
    assert soft > 1000, "the mattes of this test must be soft"


def test_black_points_are_coloured_from_the_photos(make_case: Callable[..., Case]) -> None:
    """Oracle: the brightness of the blobs at the points."""
    case = make_case("data_COLMAP")
    dataset = load_dataset(DataConfig(source=case.root / "data_COLMAP/000000", resolution=1))
    assert len(dataset.scene.points) == 40
    assert any("are black" in warning for warning in dataset.warnings)
    assert dataset.scene.points.colors.mean() > 60


def test_photos_with_alpha_serve_too(make_case: Callable[..., Case]) -> None:
    """Oracle: the same mattes, read from `rgba` and `com` instead of `pha`."""
    for layout, folder in (("per_frame", "rgba"), ("per_view", "com")):
        case = make_case(layout)
        config = DataConfig(source=case.root / layout, frame=0, images=folder, resolution=1)
        dataset = load_dataset(config)
        assert dataset.mask_mode == "composite"
        np.testing.assert_array_equal(dataset.mask(3), case.mattes[0][3])
        shutil.rmtree(case.root)


def test_the_scripts_spellings_are_understood(make_case: Callable[..., Case]) -> None:
    """Oracle: the same views with `image`, `transforms_*.json` and `sparse/0`."""
    case = make_case("data_COLMAP", "data_ngp", "data_NeuS")
    colmap, ngp = case.root / "data_COLMAP/000005", case.root / "data_ngp/000005"
    neus = case.root / "data_NeuS/000005"
    before = [read_capture(DataConfig(source=folder)) for folder in (colmap, ngp, neus)]
    for folder in (colmap, ngp, neus):
        (folder / "images").rename(folder / "image")
    (colmap / "sparse").rename(colmap / "model")
    (colmap / "sparse").mkdir()
    (colmap / "model").rename(colmap / "sparse/0")
    for split in ("train", "test", "val"):
        (ngp / f"transform_{split}.json").rename(ngp / f"transforms_{split}.json")
    after = [read_capture(DataConfig(source=folder)) for folder in (colmap, ngp, neus)]
    for a, b in zip(before, after, strict=True):
        assert {Path(view.name).name for view in a.views} == {Path(v.name).name for v in b.views}
        assert all(view.image.is_file() for view in b.views)


def test_frames_are_picked_by_number_or_path(make_case: Callable[..., Case]) -> None:
    """Oracle: the frame number in the names of the photos."""
    root = make_case(*LAYOUTS).root

    def frame_of(capture: Capture) -> set[str]:
        return {str(view.image)[-10:-4] for view in capture.views}

    for layout in ("data_COLMAP", "per_frame", "per_view", "data_NeuS2", "data_ngp"):
        assert frame_of(read_capture(DataConfig(source=root / layout, frame=10))) == {"000010"}
    for path in ("data_COLMAP/000005", "per_frame/000005", "data_ngp/000005"):
        assert frame_of(read_capture(DataConfig(source=root / path))) == {"000005"}
        assert frame_of(read_capture(DataConfig(source=root / path, frame=5))) == {"000005"}
    for path in ("", "train/", "test/"):
        file = root / f"data_NeuS2/{path}transform_000005.json"
        assert frame_of(read_capture(DataConfig(source=file))) == {"000005"}
    first = read_capture(DataConfig(source=root))
    assert frame_of(first) == {"000000"}
    assert "data_COLMAP" in str(first.views[0].image), "the layout with points comes first"
    assert "contains 3 frames, 0 to 10 in steps of 5; using frame 0" in first.warnings[-1]
    shutil.rmtree(root / "data_COLMAP/000010")
    other = read_capture(DataConfig(source=root, frame=10))
    assert "per_frame" in str(other.views[0].image), "the next layout that has the frame"
    with pytest.raises(DatasetError, match=r"no frame 7: data_COLMAP has 2, 0 to 5 in steps of 5"):
        read_capture(DataConfig(source=root, frame=7))
    with pytest.raises(ConfigError, match="is frame 5, but `--frame` is 10"):
        read_capture(DataConfig(source=root / "per_frame/000005", frame=10))
    with pytest.raises(ConfigError, match="not a multi-view video"):
        read_capture(DataConfig(source=root / "cams", frame=5))


@pytest.mark.parametrize("layout", ["", *LAYOUTS])
def test_every_layout_is_a_sequence(make_case: Callable[..., Case], layout: str) -> None:
    """Oracle: the written frames; with the rig, the cameras of the first and other photos."""
    case = make_case(layout or "data_COLMAP")
    found = find_frames(DataConfig(source=case.root / layout, eval=True))
    assert [frame.number for frame in found] == list(FRAMES)
    first = read_capture(found[0].data)
    last = found[-1].data
    assert last.eval
    joined = read_capture(replace(last, rig=found[0].data.source))
    key = operator.attrgetter("name")
    for a, b in zip(sorted(first.views, key=key), sorted(joined.views, key=key), strict=True):
        np.testing.assert_allclose(a.viewmat, b.viewmat, atol=1e-9)
        assert np.any(read_image(a.image) != read_image(b.image))


def test_splits(make_case: Callable[..., Case]) -> None:
    """Oracle: the camera numbers: the last ones, those of the JSON files, every n-th."""
    root = make_case(*LAYOUTS).root

    def test_cameras(layout: str, **options: Any) -> list[int]:
        dataset = load_dataset(DataConfig(source=root / layout, frame=5, eval=True, **options))
        assert sorted(dataset.train + dataset.test) == list(range(VIEWS))
        return [int(Path(dataset.names[i]).name.split("_")[2]) for i in dataset.test]

    for layout in ("data_COLMAP", "per_frame", "per_view"):
        assert test_cameras(layout, test_last=2) == [10, 11]
        assert test_cameras(layout, test_every=6) == [0, 6]
    for layout in ("data_NeuS2", "data_ngp"):
        assert test_cameras(layout) == list(TEST)
        assert test_cameras(layout, test_last=2) == [10, 11]


def test_cams_of_shrunken_photos(make_case: Callable[..., Case]) -> None:
    """Oracle: K at the size of the photos; COLMAP exports the cameras of 4K photos at 2000 px."""
    case = make_case("per_frame")
    case.write_cams(shrink=0.5)
    dataset = load_dataset(DataConfig(source=case.root, frame=0, resolution=1))
    np.testing.assert_allclose(dataset.scene.cameras.Ks[4], K, rtol=1e-9)
    broken = case.root / "cams/00000003_cam.txt"
    broken.write_text(broken.read_text().replace(" 9.0", " 16.0"))
    with pytest.raises(DatasetError, match=r"00000003_cam\.txt belongs to photos of about 32 x 32"):
        read_capture(DataConfig(source=case.root, frame=0))


def test_a_rig_joins_the_worlds_of_frames(
    make_case: Callable[..., Case], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the cameras of frame 0, and the true blobs of frame 5 in the world of frame 0."""
    case = make_case("data_COLMAP")
    rig = case.root / "data_COLMAP/000000"
    alone = read_capture(DataConfig(source=case.root / "data_COLMAP/000005"))
    joined = read_capture(DataConfig(source=case.root, frame=5, rig=rig))
    first = read_capture(DataConfig(source=rig))
    assert not np.allclose(alone.points.points, joined.points.points, atol=0.1)
    wanted = transform_splats(splats_at(5), world_of(0)).means
    np.testing.assert_allclose(joined.points.points, wanted, atol=1e-4)
    for a, b in zip(joined.views, first.views, strict=True):
        assert a.name[:12] == b.name[:12]
        assert a.image != b.image
        np.testing.assert_array_equal(a.viewmat, b.viewmat)
        np.testing.assert_array_equal(a.camera.params, b.camera.params)
    assert not any("differ by" in warning for warning in joined.warnings)
    monkeypatch.setattr("gscore.datasets.rig._REPORTED", -1.0)
    reported = read_capture(DataConfig(source=case.root, frame=5, rig=rig)).warnings
    assert "differ by 0.00 %" in reported[-1]
    same = read_capture(DataConfig(source=rig, rig=rig))
    assert not any("moved" in warning for warning in same.warnings)


def test_points_come_from_the_nearest_model(make_case: Callable[..., Case]) -> None:
    """Oracle: the true blobs of the frame with a model, in the world of each layout's cameras."""
    case = make_case(*LAYOUTS)
    shutil.rmtree(case.root / "data_COLMAP/000010")
    for layout in LAYOUTS[1:]:
        world = world_of(0 if layout.startswith("per_") else 10)
        capture = read_capture(DataConfig(source=case.root / layout, frame=10))
        wanted = transform_splats(splats_at(5), world).means
        np.testing.assert_allclose(capture.points.points, wanted, atol=1e-4)
        assert "starting from those of" in capture.warnings[-1]
    (case.root / "data_COLMAP/000005/sparse/images.bin").write_bytes(b"short")
    capture = read_capture(DataConfig(source=case.root / "per_view", frame=5))
    assert len(capture.points) == 0
    assert "cannot be used" in capture.warnings[-1]


def test_a_rig_with_a_wrong_and_a_lost_camera(make_case: Callable[..., Case]) -> None:
    """Oracle: the true blobs; the true place of the camera that frame 0 lacks."""
    case = make_case("data_COLMAP")
    zero, five = (case.root / f"data_COLMAP/{frame:06d}" for frame in (0, 5))
    model = case.model(0)
    write_model(replace(model, images=model.images[1:]), zero / "sparse")
    model = case.model(5, noise=1e-3)
    images = [*model.images]
    images[7] = replace(images[7], tvec=images[7].tvec + 5)
    write_model(replace(model, images=images), five / "sparse")
    joined = read_capture(DataConfig(source=five, rig=zero))
    wanted = transform_splats(splats_at(5), world_of(0)).means
    size = np.ptp(wanted, axis=0).max()
    assert np.abs(joined.points.points - wanted).max() < 2e-3 * size
    lost = next(view for view in joined.views if "c_000" in view.name)
    true = moved(viewmats()[0], world_of(0))
    np.testing.assert_allclose(lost.viewmat[:3, :3], true[:3, :3], atol=1e-3)
    np.testing.assert_allclose(lost.viewmat[:3, 3], true[:3, 3], atol=0.02)
    assert "1 view is not in" in joined.warnings[-1]


def test_another_rig_is_refused(make_case: Callable[..., Case]) -> None:
    """Oracle: cameras at other places, and cameras with other names."""
    case = make_case("data_COLMAP")
    zero, five = (case.root / f"data_COLMAP/{frame:06d}" for frame in (0, 5))
    model = case.model(5, noise=0.7)
    write_model(model, five / "sparse")
    with pytest.raises(DatasetError, match="are not arranged as those of"):
        read_capture(DataConfig(source=five, rig=zero))
    far = [replace(image, name=f"x{image.id}_c_9{image.id:02d}_f_5.png") for image in model.images]
    write_model(replace(model, images=far), zero / "sparse")
    with pytest.raises(DatasetError, match="have 0 cameras in common"):
        read_capture(DataConfig(source=five, rig=zero))


def _edit(path: str, change: Callable[[str], str]) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        (root / path).write_text(change((root / path).read_text()))

    return damage


def _json(path: str, change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    def damage(root: Path) -> None:
        data = json.loads((root / path).read_text())
        change(data)
        (root / path).write_text(json.dumps(data))

    return damage


CAM = "cams/00000002_cam.txt"
NEUS2 = "data_NeuS2/transform_000000.json"
NGP = "data_ngp/000000/transform_train.json"
NPZ = "data_NeuS/000000/cameras_sphere.npz"


@pytest.mark.parametrize(
    ("layout", "damage", "error", "message"),
    [
        ("per_frame", lambda r: shutil.rmtree(r / "cams"), DatasetError, "no folder .*cams"),
        ("per_frame", lambda r: (r / CAM).unlink(), DatasetError, "none for 1 of the 12 photos"),
        (
            "per_frame",
            lambda r: shutil.copy(r / CAM, r / "cams/2_cam.txt"),
            DatasetError,
            "camera 2 twice",
        ),
        ("per_frame", _edit(CAM, lambda t: t[:60]), FormatError, "ends within the extrinsic"),
        ("per_frame", _edit(CAM, lambda t: t.replace("in", "")), FormatError, "no 'extrinsic'"),
        ("per_frame", _edit(CAM, lambda t: t.replace("63.6", "six")), FormatError, "'six' in the"),
        (
            "per_frame",
            _edit(CAM, lambda t: t.replace("63.6", "-63.6")),
            FormatError,
            "intrinsic is",
        ),
        (
            "per_frame",
            _edit(CAM, lambda t: t.replace("63.6", "1e-30")),
            FormatError,
            "focal lengths are 60 and 1e-30 pixels|focal lengths are 1e-30 and",
        ),
        (
            "data_NeuS2",
            _json(NEUS2, lambda d: d["frames"][3]["intrinsic_matrix"][0].__setitem__(0, 1e29)),
            FormatError,
            r"frame 3: intrinsic_matrix: the focal lengths are 1e\+29 and",
        ),
        ("data_ngp", _json(NGP, lambda d: d.update(fl_x=1e-30)), FormatError, "are 1e-30 and"),
        ("per_frame", _edit(CAM, lambda t: t.replace("0.0 0.0 0.0 1.0", "")), GsError, CAM[5:]),
        (
            "per_frame",
            _edit(
                CAM,
                lambda t: (
                    "extrinsic\n" + "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1" + t[t.index("\n\nin") :]
                ),
            ),
            FormatError,
            "Remove the scale",
        ),
        ("per_frame", lambda r: (r / CAM).write_bytes(b"\xff\xfe\x00"), FormatError, "is not text"),
        (
            "per_frame",
            lambda r: shutil.rmtree(r / "per_frame/000000/images"),
            DatasetError,
            r"no photo folder images or image in .*000000 \(there are pha, rgba\)",
        ),
        (
            "per_frame",
            lambda r: shutil.copy(
                r / "per_frame/000000/images/image_c_001_f_000000.png",
                r / "per_frame/000000/images/other_c_001_f_000000.png",
            ),
            DatasetError,
            "two pictures of camera 1",
        ),
        (
            "per_view",
            lambda r: [(r / f"per_view/cam_{i}/images/000000.png").unlink() for i in range(7)],
            DatasetError,
            "Frame 0 is missing in 7 of the 12 views",
        ),
        ("data_NeuS2", _edit(NEUS2, lambda t: t[:-9]), FormatError, "is not JSON"),
        (
            "data_NeuS2",
            _json(NEUS2, lambda d: d["frames"][3].pop("intrinsic_matrix")),
            FormatError,
            "frame 3: intrinsic_matrix is None",
        ),
        ("data_NeuS2", _json(NEUS2, lambda d: d.pop("w")), FormatError, "w is None"),
        (
            "data_NeuS2",
            _json(NEUS2, lambda d: d["frames"][2].update(file_path="../../x.png")),
            FormatError,
            "inside the folder",
        ),
        (
            "data_NeuS2",
            _json(NEUS2, lambda d: d["frames"][2]["transform_matrix"][0].__setitem__(0, 9)),
            FormatError,
            "transform_matrix is",
        ),
        (
            "data_NeuS2",
            lambda r: shutil.rmtree(r / "data_NeuS2/images/000000"),
            DatasetError,
            "12 of the 12 photos",
        ),
        (
            "data_ngp",
            lambda r: [p.unlink() for p in (r / "data_ngp/000000").glob("*.json")],
            DatasetError,
            r"no transform_train\.json",
        ),
        ("data_ngp", _json(NGP, lambda d: d.pop("fl_x")), FormatError, "neither fl_x nor"),
        (
            "data_NeuS",
            lambda r: (r / NPZ).write_bytes(b"PK\3\4no"),
            FormatError,
            "cannot be read as",
        ),
        ("data_NeuS", lambda r: (r / NPZ).unlink(), DatasetError, "There is no"),
        (
            "data_NeuS",
            lambda r: (r / "data_NeuS/000000/images/003.png").unlink(),
            DatasetError,
            "has 12 cameras, .* has 11",
        ),
        (
            "data_COLMAP",
            lambda r: shutil.rmtree(r / "data_COLMAP/000000/sparse"),
            DatasetError,
            "No COLMAP model",
        ),
        ("data_COLMAP", lambda r: shutil.rmtree(r), DatasetError, "There is no folder"),
        (
            "data_COLMAP",
            lambda r: shutil.rmtree(r / "data_COLMAP"),
            ConfigError,
            "not a multi-view",
        ),
        (
            "data_COLMAP",
            lambda r: shutil.rmtree(r / "data_COLMAP/000000"),
            DatasetError,
            "no frame 0: data_COLMAP has 2, 5 to 10 in steps of 5",
        ),
        (
            "data_COLMAP",
            lambda r: [shutil.rmtree(r / f"data_COLMAP/{f:06d}") for f in FRAMES],
            DatasetError,
            "contains no frames",
        ),
    ],
)
def test_damage_is_named(
    make_case: Callable[..., Case],
    layout: str,
    damage: Callable[[Path], object],
    error: type[GsError],
    message: str,
) -> None:
    """Oracle: one sentence with the damaged file, for each way to damage a layout."""
    root = make_case(layout).root
    read_capture(DataConfig(source=root, frame=0))
    damage(root)
    with pytest.raises(error, match=message) as raised:
        read_capture(DataConfig(source=root, frame=0))
    assert str(root) in str(raised.value)


def test_lost_photos_are_warned_about(make_case: Callable[..., Case]) -> None:
    """Oracle: the number of views left."""
    root = make_case("per_view", "data_NeuS2", "data_ngp").root
    (root / "per_view/cam_3/images/000005.png").unlink()
    for folder in ("data_NeuS2/images/000005", "data_ngp/000005/images"):
        (root / folder / "image_c_003_f_000005.png").unlink()
    for layout in ("per_view", "data_NeuS2", "data_ngp"):
        capture = read_capture(DataConfig(source=root / layout, frame=5))
        assert len(capture.views) == VIEWS - 1
        assert any("1 of the 12" in warning for warning in capture.warnings)

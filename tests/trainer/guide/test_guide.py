"""Meshes that guide a training; oracles: closed forms of planes, the mesh itself, bytes, texts."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gscore.commands import main
from gscore.config import DataConfig, TrainConfig
from gscore.datasets import Dataset, load_dataset
from gscore.datasets.tracks import tracks_of
from gscore.errors import ConfigError
from gscore.events import Event, Started, Warn
from gscore.io.colmap.folder import read_model, write_model
from gscore.io.mesh.files import write_mesh
from gscore.raster.api import render
from gscore.scene import Cameras
from gscore.splats import Splats
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.depth.targets import DepthTargets
from gscore.trainer.estimate.forecast import depth_bytes, estimate
from gscore.trainer.guide.mesh_views import MeshFreeSpace, MeshView
from gscore.trainer.guide.setup import GuideSetup, MeshSupport, prepare_guide, weighted_views
from gscore.trainer.run import train
from gscore.trainer.trainer import Trainer
from gscore.transforms import Similarity
from tests.exact_depth_maps import exact_depth_maps
from tests.trainer.short_run import CONFIG


def wall(path: Path, offset: float = 0.0, half: float = 0.8) -> Path:
    """A square through the middle of the toy capture, z = `offset`, with half of the cameras on
    either side."""
    corners = [[-half, -half], [half, -half], [half, half], [-half, half]]
    vertices = np.array([[x, y, offset] for x, y in corners])
    write_mesh(path, vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    return path


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    return wall(tmp_path / "wall.ply")


@pytest.fixture
def dataset(capture: Path) -> Dataset:
    return load_dataset(DataConfig(source=capture, eval=True, test_every=4))


@pytest.fixture
def all_photos(capture: Path) -> Dataset:
    return load_dataset(DataConfig(source=capture))


def seen_depth(cameras: Cameras, index: int, offset: float) -> np.ndarray:
    """[H, W] camera z of the plane z = `offset` at each pixel; not positive: behind the camera."""
    u, v = np.meshgrid(np.arange(48) + 0.5, np.arange(48) + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(cameras.Ks[index]).T
    towards = rays @ cameras.viewmats[index, :3, :3]
    return (offset - cameras.centers[index, 2]) / towards[..., 2]


def test_depths_of_a_wall_in_photos(dataset: Dataset, mesh: Path) -> None:
    """Oracle: the plane's depth in closed form; none for held-out photos."""
    cameras = dataset.scene.cameras
    views = prepare_guide(TrainConfig(guide_free=mesh), dataset, tracks_of(dataset)).free
    assert tuple(dataset.test) == (0, 4)
    edge_on = (2, 6)
    assert [i for i, view in enumerate(views) if view is None] == [0, 2, 4, 6]
    for i in set(dataset.train) - set(edge_on):
        view, z = views[i], seen_depth(cameras, i, 0.0)
        known = view.inverse_depth > 0
        np.testing.assert_allclose(view.inverse_depth[known] * z[known], 1, rtol=1e-5)
        inner = view.confidence > 0.5
        assert (known & ~inner).any()  # the outline
        assert not (inner & ~known).any()
        assert inner.sum() > 100


def test_masks_hide_what_photos_see_of_a_wall(capture: Path, dataset: Dataset, mesh: Path) -> None:
    """Oracle: zero confidence where a mask is black."""

    class Masked(Dataset):
        def mask(self, index: int) -> np.ndarray | None:
            hiding = np.full((48, 48), 255, np.uint8)
            hiding[:, :24] = 0
            return hiding

    masked = Masked(
        scene=dataset.scene,
        files=list(dataset.files),
        train=list(dataset.train),
        test=list(dataset.test),
        mask_mode="ignore",
        source=dataset.source,
    )
    plain = prepare_guide(TrainConfig(guide_free=mesh), dataset, tracks_of(dataset)).free
    hidden = prepare_guide(TrainConfig(guide_free=mesh), masked, tracks_of(masked)).free
    for before, view in zip(plain, hidden, strict=True):
        if view is not None and before is not None:
            assert not view.confidence[:, :24].any()
            np.testing.assert_array_equal(view.confidence[:, 26:], before.confidence[:, 26:])


def test_free_space_is_what_lies_before_the_wall(dataset: Dataset, mesh: Path) -> None:
    """Oracle: float64 rays from each camera through each place to the plane; places within 8 % of
    it, or within two pixels of the mesh's outline, may be either."""
    cameras = dataset.scene.cameras
    similarity = Similarity.fit(cameras.centers)
    views = prepare_guide(TrainConfig(guide_free=mesh), dataset, tracks_of(dataset)).free
    rng = np.random.default_rng(1)
    places = rng.uniform(-3, 3, (4000, 3))
    space = MeshFreeSpace(views, cameras, similarity)
    moved = torch.from_numpy(similarity.points_to_training(places).astype(np.float32))
    found = space.contains(moved).numpy()
    sure_in, sure_out = np.zeros(4000, bool), np.ones(4000, bool)
    for i in dataset.train:
        center = cameras.centers[i]
        t = -center[2] / (places[:, 2] - center[2])  # of the hit; 1 at the place
        hit = np.abs(center[:2] + t[:, None] * (places[:, :2] - center[:2])).max(axis=1)
        local = places @ cameras.viewmats[i, :3, :3].T + cameras.viewmats[i, :3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixel = local[:, :2] / local[:, 2:] * cameras.Ks[i, 0, 0] + 24
        shown = (local[:, 2] > 0) & (np.abs(pixel - 24) < 22).all(axis=1)
        facing = abs(cameras.viewmats[i, 2, 2]) > 0.5
        sure_in |= facing & shown & (t > 1.09) & (hit < 0.6)
        sure_out &= (t < 1) | (t > 1e6) | (hit > 0.8) | (local[:, 2] <= 0)
    assert sure_in.sum() > 30 and sure_out.sum() > 1000
    assert found[sure_in].all()
    assert not found[sure_out].any()


def test_splats_before_a_wall_are_taken_out(
    all_photos: Dataset, known_splats: Splats, mesh: Path
) -> None:
    """Oracle: their known places: a few splats between cameras and wall are removed, those on it
    stay."""
    guide = prepare_guide(TrainConfig(guide_free=mesh), all_photos, tracks_of(all_photos))
    flat = known_splats.means.copy()
    flat[:, 2] = 0.01 * np.sign(flat[:, 2])
    flat[:5] = [0.1, 0.1, -1.5], [0, 0, 1.5], [0.2, 0, -1], [0, 0.2, 1], [0, 0, -0.9]
    start = replace(known_splats, means=flat, opacities=np.full(len(flat), 6.0, np.float32))
    config = replace(CONFIG, prune_opacity=0.0, grow_grad=1e9, free_space=0.0)
    trainer = Trainer(config, Analysis(photos=all_photos, start=start, guide=guide))
    plain = Trainer(config, Analysis(photos=all_photos, start=start))
    for _ in range(10):
        assert trainer.step().change.removed in (0, 5)
        plain.step()
    assert (trainer.pruner.guided.count, len(trainer.model)) == (5, len(flat) - 5)
    assert len(plain.model) == len(flat)


def test_a_crowd_before_a_wall_stays(all_photos: Dataset, known_splats: Splats, mesh: Path) -> None:
    """Oracle: the same number of splats, also after a resume."""
    guide = prepare_guide(TrainConfig(guide_free=mesh), all_photos, tracks_of(all_photos))
    moved = known_splats.means.copy()
    moved[:, 2] -= 1.2
    start = replace(known_splats, means=moved)
    config = replace(CONFIG, prune_opacity=0.0, grow_grad=1e9, free_space=0.0)
    trainer = Trainer(config, Analysis(photos=all_photos, start=start, guide=guide))
    for _ in range(10):
        trainer.step()
    assert trainer.pruner.guided.crowded and trainer.pruner.guided.count == 0
    assert len(trainer.model) == len(moved)
    again = Trainer(config, Analysis(photos=all_photos, start=start, guide=guide))
    again.restore(trainer.state(), dict(trainer.tensors()))
    assert again.pruner.guided.crowded


def off_wall(splats: Splats, dataset: Dataset) -> float:
    """Mean relative difference to the inverse depth of the wall, in the middle of photos."""
    cameras, found = dataset.scene.cameras, []
    for i in dataset.train:
        z = seen_depth(cameras, i, 0.0)
        view = render(splats, cameras.Ks[i], cameras.viewmats[i], 48, 48)
        assert view.inverse_depth is not None
        inner = np.zeros((48, 48), bool)
        inner[18:30, 18:30] = abs(cameras.viewmats[i, 2, 2]) > 0.6
        found.append(np.abs(view.inverse_depth[inner] * z[inner] - 1))
    return float(np.concatenate(found).mean())


def test_splats_come_to_lie_on_a_wall(dataset: Dataset, mesh: Path) -> None:
    """Oracle: the plane; more than twice the error without the guide."""
    guide = prepare_guide(TrainConfig(guide_surface=mesh), dataset, tracks_of(dataset))
    config = replace(CONFIG, iterations=300, refine_stop=250, reset_every=-1)
    found = {}
    for name, given in (("with", guide), ("without", GuideSetup())):
        trainer = Trainer(config, Analysis(photos=dataset, guide=given))
        for _ in range(300):
            trainer.step()
        found[name] = off_wall(trainer.splats(), dataset)
    assert found["with"] < 0.5 * found["without"], found


def test_a_weight_of_zero_changes_no_bit(dataset: Dataset, mesh: Path) -> None:
    """Oracle: the training without a guide."""
    guide = prepare_guide(TrainConfig(guide_surface=mesh), dataset, tracks_of(dataset))
    plain = Trainer(CONFIG, Analysis(photos=dataset))
    guided = Trainer(replace(CONFIG, guide_weight=0.0), Analysis(photos=dataset, guide=guide))
    for _ in range(20):
        assert plain.step().loss == guided.step().loss
    for name, tensor in plain.tensors().items():
        assert torch.equal(tensor, guided.tensors()[name]), name


@pytest.fixture
def tracked(capture: Path, tmp_path: Path) -> Dataset:
    """The toy capture with tracks: each photo lists all points in its frame."""
    root = tmp_path / "tracked"
    shutil.copytree(capture, root)
    model = read_model(root)
    images = []
    for image in model.images:
        local = model.points.xyz @ image.viewmat[:3, :3].T + image.viewmat[:3, 3]
        pixels = local @ model.cameras[image.camera_id].K.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        seen = ((pixels > 0) & (pixels < 48)).all(axis=1)
        images.append(replace(image, xys=pixels[seen], point3D_ids=model.points.ids[seen]))
    write_model(replace(model, images=images), root / "sparse/0")
    return load_dataset(DataConfig(source=root, eval=True, test_every=4))


def reported(found: Any) -> str:
    return found.decision.text.partition("; ")[2]


def test_points_say_where_a_mesh_is(tracked: Dataset, dataset: Dataset, tmp_path: Path) -> None:
    """Oracle: the points of the capture against the plane's depth, one by one; a warning for a wall
    in front of most of them, and no message for photos without tracks."""
    near = wall(tmp_path / "near.ply", offset=-1.6, half=3.0)
    found = prepare_guide(TrainConfig(guide_surface=near), tracked, tracks_of(tracked))
    assert len(found.warnings) == 1 and "wrong place" in found.warnings[0]
    middle = wall(tmp_path / "middle.ply", offset=0.1, half=0.5)
    cameras, points = tracked.scene.cameras, tracked.scene.points.points
    counts = {"on": 0, "before": 0, "behind": 0}
    for i in tracked.train:
        z = seen_depth(cameras, i, 0.1)
        view = prepare_guide(TrainConfig(guide_free=middle), tracked, tracks_of(tracked)).free[i]
        for point in points:
            local = cameras.viewmats[i, :3, :3] @ point + cameras.viewmats[i, :3, 3]
            u, v = cameras.Ks[i, 0, 0] * local[:2] / local[2] + 24
            if view is None or not (local[2] > 0 and 0 <= u < 48 and 0 <= v < 48):
                continue
            if not view.inverse_depth[int(v), int(u)]:
                continue
            ratio = local[2] / z[int(v), int(u)]
            counts["on" if abs(ratio - 1) <= 0.05 else "before" if ratio < 1 else "behind"] += 1
    total = sum(counts.values())
    assert total > 50 and min(counts.values()) > 5
    on, before, behind = (f"{count / total:.0%}" for count in counts.values())
    assert reported(
        prepare_guide(TrainConfig(guide_surface=middle), tracked, tracks_of(tracked))
    ) == (
        f"of the points observed there {on} are on it within 5%, {before} in front of it and "
        f"{behind} behind it."
    )
    silent = prepare_guide(TrainConfig(guide_surface=near), dataset, tracks_of(dataset))
    assert reported(silent).startswith("almost no points") and not silent.warnings


def test_pixels_are_trusted_as_points_around_them_say() -> None:
    """Oracle: the definition, pixel by pixel with all distances; every other pixel of a large
    photo."""
    rng = np.random.default_rng(2)
    many = MeshSupport(pixels=np.zeros((80, 2)), ratios=np.array([1.0] * 20 + [2.0] * 60))
    nothing = MeshSupport(pixels=np.zeros((0, 2)), ratios=np.zeros(0))
    for width, height, count, others in (
        (60, 40, 30, []),
        (60, 40, 2, [many]),
        (900, 50, 40, [nothing, many]),
    ):
        pixels = rng.uniform(0, 1, (count, 2)) * (width, height)
        ratios = rng.choice([0.8, 0.96, 1.04, 1.3], count)
        trust = rng.random((height, width), np.float32)
        view = MeshView(inverse_depth=np.ones((height, width), np.float32), confidence=trust)
        seen = MeshSupport(pixels=pixels, ratios=ratios)
        (found, *_) = weighted_views([view, *[None] * len(others)], [seen, *others])
        assert found is not None
        step = 1 if width < 400 else 2
        everywhere = np.concatenate([ratios, *(other.ratios for other in others)])
        on, behind = np.abs(everywhere - 1) <= 0.05, everywhere > 1.05
        alone = on.sum() / (on | behind).sum() if (on | behind).sum() >= 50 else 1.0
        for v in range(0, height, 7 * step):
            for u in range(0, width, 3 * step):
                place = np.array([u, v]) + step / 2
                distance = np.linalg.norm(pixels - place, axis=1)
                order = [k for k in np.argsort(distance)[:3] if distance[k] < 0.1 * width]
                on = [abs(ratios[k] - 1) <= 0.05 for k in order]
                share = np.mean(on) if on else alone
                assert found.confidence[v, u] == pytest.approx(trust[v, u] * share, rel=1e-5)
    assert weighted_views([view, None], [None, None]) == [view, None]


UNSEEN = {
    "behind": ([[0, 9, 0], [1, 9, 0], [0, 9, 1]], "outside all their frames"),
    "far": ([[900, 900, 900], [901, 900, 900], [900, 901, 900]], "shows the mesh, which is"),
    "a line": ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], "none of 6 training photos shows the mesh"),
}


@pytest.mark.parametrize("name", UNSEEN)
def test_a_mesh_that_no_photo_sees_is_refused(
    capture: Path, tmp_path: Path, refused: Callable[..., None], name: str
) -> None:
    """Oracle: exit code 2, one sentence that names the file and both places."""
    vertices, sentence = UNSEEN[name]
    path = tmp_path / "mesh.ply"
    write_mesh(path, np.array(vertices, np.float64), np.array([[0, 1, 2]]))
    line = [str(capture), "-o", "{out}", "--guide-surface", str(path), "--eval"]
    refused("train", [*line, "--hold-out", "4"], sentence)


@pytest.mark.parametrize("flag", ["--guide-surface", "--guide-free"])
def test_files_that_hold_no_mesh_are_refused(
    capture: Path, tmp_path: Path, refused: Callable[..., None], flag: str
) -> None:
    """Oracle: exit code 2 and the readers' sentences."""
    path = tmp_path / "mesh.obj"
    path.write_text("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n")
    refused("train", [str(capture), "-o", "{out}", flag, str(path)], "not finite or larger")
    path.write_text("")
    refused("train", [str(capture), "-o", "{out}", flag, str(path)], "has no faces")
    refused("train", [str(capture), "-o", "{out}", flag, str(tmp_path / "no.ply")], "no such file")


def test_a_run_says_what_guides_it_and_goes_on(
    capture: Path, tmp_path: Path, mesh: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: one sentence at the start; bytes of the run without a break; the refusal of another
    mesh under the same name."""
    data = DataConfig(source=capture)
    config = replace(
        CONFIG, guide_surface=mesh, guide_free=mesh, checkpoint_iterations=(30,), seed=3
    )
    events: list[Event] = []
    whole = train(config, data, tmp_path / "whole", events.append)
    started = next(event for event in events if isinstance(event, Started))
    assert started.decision("guide").startswith("Surface mesh wall.ply covers")
    assert "Free-space mesh wall.ply" in started.decision("guide")
    assert not [e for e in events if isinstance(e, Warn) and "wall" in e.message]
    half = next((tmp_path / "whole").glob("checkpoints/*30*"))
    moved = wall(tmp_path / "moved.ply")  # its folder may differ
    again = train(
        replace(config, guide_surface=moved), data, tmp_path / "again", start_checkpoint=half
    )
    assert again.splats.means.tobytes() == whole.splats.means.tobytes()
    wall(mesh, offset=0.1)
    with pytest.raises(ConfigError, match="its guide meshes differ"):
        train(config, data, tmp_path / "other", start_checkpoint=half)
    with pytest.raises(ConfigError, match="its guide meshes differ"):
        train(
            replace(config, guide_surface=None, guide_free=None),
            data,
            tmp_path / "none",
            start_checkpoint=half,
        )
    line = ["train", str(capture), "-o", str(tmp_path / "cli"), "--iterations", "4"]
    assert main([*line, "--guide-weight", "2", "--max-splats", "200"]) == 0
    assert "--guide-weight (only with --guide-surface)" in capsys.readouterr().err


def test_maps_and_a_guide_count_both(dataset: Dataset, known_splats: Splats, mesh: Path) -> None:
    """Oracle: the loss of the photo and of either term alone, summed."""
    guide = prepare_guide(TrainConfig(guide_surface=mesh), dataset, tracks_of(dataset))
    maps = DepthTargets(exact_depth_maps(dataset, known_splats), train=dataset.train, views=8)
    config = replace(CONFIG, depth_warmup=0.0)
    found = {
        (bool(depth), given is guide): Trainer(
            config, Analysis(photos=dataset, depth=depth, guide=given)
        )
        .step()
        .loss
        for depth in (None, maps)
        for given in (GuideSetup(), guide)
    }
    by_maps, by_mesh = (found[key] - found[False, False] for key in ((True, False), (False, True)))
    assert min(by_maps, by_mesh) > 1e-3
    assert found[True, True] == pytest.approx(found[False, False] + by_maps + by_mesh, rel=1e-5)


def test_memory_of_a_surface_is_foreseen() -> None:
    """Oracle: the memory of depth maps for each of the same photos."""
    sizes, config = [(1000, 1000)] * 100, TrainConfig(max_splats=1000)

    def peak(guides: int, *, depths: bool) -> int:
        paths = [Path("a.ply")] * guides + [None] * 2
        given = replace(config, guide_surface=paths[0], guide_free=paths[1])
        return estimate(given, sizes, points=9, depths=depths, free=10**12, pace=1.0).peak_bytes

    maps = depth_bytes(100 * 1000 * 1000)
    found = [peak(0, depths=False), peak(1, depths=False), peak(2, depths=False)]
    found.append(peak(2, depths=True))
    assert np.diff(found) == pytest.approx([maps] * 3, rel=0.15)  # forecasts are rounded


@pytest.mark.slow
def test_no_triangle_too_many_is_silent(tmp_path: Path, dataset: Dataset) -> None:
    """Oracle: the depth of a plane, for its grid of a million triangles."""
    side = 708
    x, y = np.meshgrid(np.linspace(-0.8, 0.8, side), np.linspace(-0.8, 0.8, side))
    at = np.arange(side * side).reshape(side, side)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)])
    assert len(triangles) > 999_000
    path = tmp_path / "many.ply"
    write_mesh(path, np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1), triangles)
    fine = prepare_guide(TrainConfig(guide_free=path), dataset, tracks_of(dataset)).free
    plain = prepare_guide(
        TrainConfig(guide_free=wall(tmp_path / "w.ply")), dataset, tracks_of(dataset)
    ).free
    for one, other in zip(fine, plain, strict=True):
        if one is not None and other is not None:
            np.testing.assert_allclose(one.inverse_depth, other.inverse_depth, atol=2e-5)

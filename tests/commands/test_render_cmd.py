"""gscore render: stills, depth, transparency, paths and videos against the rasterizer itself."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from gscore.commands.pictures.stills import still_names, write_depth_png
from gscore.errors import ShapeError
from gscore.io.cameras_json import read_cameras_json, write_cameras
from gscore.io.exposure_json import EXPOSURE_FILE, write_exposures
from gscore.io.ply.splats import write_splats
from gscore.photo_exposure import PhotoExposure
from gscore.raster.api import render


def read(path):
    return np.asarray(Image.open(path))


def as_bytes(picture):
    return (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)


def test_all_views_of_a_run(gscore, run_folder, tmp_path, picture, capture):
    """Oracle: the photos of the capture, which are renders of the same splats, bit for bit."""
    code, out, _ = gscore("render", run_folder(), "-o", tmp_path / "out", "--json")
    facts = json.loads(out)
    assert code == 0 and facts["pictures"] == 9 and facts["splats"] == 60 and facts["fps"] > 0
    assert (facts["width"], facts["height"]) == (48, 36)
    for i in range(9):
        made = read(tmp_path / "out" / f"a_{i}.png")
        assert made.max() > 100
        np.testing.assert_array_equal(made, as_bytes(picture(i).rgb))
        np.testing.assert_array_equal(made, read(capture / "images" / f"a_{i}.png"))


def test_pictures_are_exposed_as_photos(gscore, run_folder, tmp_path, picture, cameras):
    """Oracle: the rasterizer's pictures over white with the exposures of exposure.json, but for
    the background."""
    folder = run_folder()
    gains = {f"a_{i}.png": np.array([0.5, 0.7, 1.0]) + i / 20 for i in range(9)}
    write_exposures(folder / EXPOSURE_FILE, {n: PhotoExposure.of(g) for n, g in gains.items()})

    def made(name, *arguments):
        out = tmp_path / "-".join(["out", *arguments])
        options = ("--quiet", "--background", "white", *arguments)
        code, _, err = gscore("render", folder, "-o", out, *options)
        assert code == 0, err
        return read(out / f"{name}.png").astype(int)

    def expected(index, gain):
        seen = picture(index)
        alpha = seen.alpha[..., None]
        return as_bytes((seen.rgb + 0.055 * alpha) * gain + 1 - 1.055 * alpha).astype(int)

    one = gains["a_5.png"]
    for arguments, gain in (((), None), (("--exposure", "even"), 1), (("--exposure", "a_5"), one)):
        for i in (2, 8):
            wanted = expected(i, gains[f"a_{i}.png"] if gain is None else gain)
            assert np.abs(made(f"a_{i}", *arguments) - wanted).max() <= 1
    even = made("frame_00001", "--path", "spline", "--frames", "3")
    photo = made("frame_00001", "--path", "spline", "--frames", "3", "--exposure", "photo")
    assert (photo <= even)[..., 0].all() and (photo < even)[..., 0].any()  # red gains are below 1
    (folder / EXPOSURE_FILE).unlink()
    code, _, err = gscore("render", folder, "-o", tmp_path / "x", "--exposure", "photo")
    assert code == 2 and "--exposure on" in err


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["--view", "a_3.png", "a_5"], ["a_3", "a_5"]),
        (["--view", "7"], ["a_7"]),
        (["--view", "7", "--view", "a_3"], ["a_3", "a_7"]),
        (["--test"], ["a_0", "a_8"]),
        (["--all"], [f"a_{i}" for i in range(9)]),
    ],
)
def test_which_views(gscore, run_folder, tmp_path, arguments, wanted):
    """Oracle: the requested names; the test views in metrics.json."""
    code, _, _ = gscore("render", run_folder(), "-o", tmp_path / "out", *arguments, "--quiet")
    assert code == 0
    assert sorted(p.stem for p in (tmp_path / "out").iterdir()) == wanted


def test_cameras_of_the_capture_and_resolution(
    gscore, run_folder, tmp_path, capture, splats, cameras
):
    """Oracle: the rasterizer with the upper two rows of K halved."""
    folder = run_folder()
    (folder / "cameras.json").unlink()
    options = ("-s", capture, "--test", "-r", "2", "--quiet")
    code, _, _ = gscore("render", "-m", folder, "-o", tmp_path / "out", *options)
    assert code == 0
    half = cameras.Ks[0] * np.array([[0.5], [0.5], [1.0]])
    wanted = as_bytes(render(splats, half, cameras.viewmats[0], 24, 18).rgb)
    small = read(tmp_path / "out" / "a_0.png")
    assert small.shape == (18, 24, 3)
    # The model's poses are quaternions, so the last bit of a colour may differ.
    np.testing.assert_allclose(small.astype(int), wanted, atol=1)


def test_a_path_from_a_file(gscore, run_folder, tmp_path, splats, cameras):
    """Oracle: the rasterizer from each camera of the file, in its order; the pace of a video."""
    poses = [np.linalg.inv(m) @ np.diag([1.0, -1, -1, 1]) for m in cameras.viewmats[[4, 1]]]
    entries = [{"camera_to_world": pose.ravel().tolist(), "fov": 40} for pose in poses]
    content = {"render_width": 40, "render_height": 30, "fps": 12, "camera_path": entries}
    path = tmp_path / "path.json"
    path.write_text(json.dumps(content))
    given = ("render", folder := run_folder(), "--path", path)
    code, out, _ = gscore(*given, "-o", tmp_path / "out", "--json")
    assert code == 0 and json.loads(out)["path"] == str(path)
    focal = 15 / np.tan(np.radians(20))
    K = np.array([[focal, 0, 20], [0, focal, 15], [0, 0, 1]])
    for i, view in enumerate((4, 1)):
        wanted = as_bytes(render(splats, K, cameras.viewmats[view], 40, 30).rgb)
        made = read(tmp_path / "out" / f"frame_{i + 1:06d}.png")
        np.testing.assert_allclose(made.astype(int), wanted, atol=1)
    code, _, err = gscore(*given, "-o", tmp_path / "out", "--frames", "5")
    assert code == 2 and "leave out --frames and --cameras" in err
    code, _, err = gscore("render", folder, "--path", "orbti", "-o", tmp_path / "out")
    assert code == 2 and "--path orbti: neither orbit nor spline, nor an existing file" in err


def test_the_documented_view_from_above(gscore, run_folder, tmp_path):
    """Oracle: docs/view.md, whose camera is above the origin and looks down, with the far side up;
    up is -Y."""
    text = (Path(__file__).parents[2] / "docs" / "view.md").read_text(encoding="utf-8")
    path = tmp_path / "cameras.json"
    path.write_text(re.findall(r"```json\n(.*?)```", text, re.DOTALL)[0])
    camera = read_cameras_json(path)
    np.testing.assert_allclose(camera.centers[0], [0, -3, 0], atol=1e-12)
    right, down, ahead = camera.viewmats[0, :3, :3]
    assert ahead.tolist() == [0, 1, 0] and down.tolist() == [0, 0, -1]
    np.testing.assert_allclose(np.cross(right, down), ahead)
    given = ("render", run_folder(), "-o", tmp_path / "out", "--json")
    for options in (("--path", path), ("-s", path, "--view", "above")):
        code, out, _ = gscore(*given, *options)
        assert code == 0 and json.loads(out)["width"] == 800


def test_pictures_of_nothing_and_tiny_ones_get_a_warning(gscore, run_folder, tmp_path):
    """Oracle: the sentences; pictures with splats, and of usual sizes, have none."""
    run = run_folder()
    given = ("render", run, "-o", tmp_path / "out", "--view", "0", "1")
    code, _, err = gscore(*given, "--near", "1000", "-r", "96")
    assert code == 0 and "No splat is in 2 of 2 pictures" in err
    assert "near plane (1000 world units" in " ".join(err.split()) and "divisor" not in err
    code, _, err = gscore(*given, "-r", "16")
    assert code == 0 and "only 16 x 12 px: above 8 -r is their width in pixels" in err
    assert "No splat" not in err
    code, _, err = gscore("eval", run, "-r", "16", "-o", tmp_path / "e")
    assert code == 0 and "only 16 x 12 px: above 8 -r is their width" in " ".join(err.split())


def test_transparency(gscore, run_folder, tmp_path, picture):
    """Oracle: the picture rendered over any background, equal to the composite over it."""
    path = tmp_path / "one.png"
    code, _, _ = gscore("render", run_folder(), "-o", path, "--view", "2", "--transparent")
    assert code == 0
    rgba = read(path).astype(float) / 255
    assert rgba.shape == (36, 48, 4) and rgba[..., 3].min() < 0.05 < 0.9 < rgba[..., 3].max()
    for background in ((0.0, 0.0, 0.0), (1.0, 0.5, 0.0)):
        over = rgba[..., :3] * rgba[..., 3:] + np.array(background) * (1 - rgba[..., 3:])
        wanted = np.clip(picture(2, background=background).rgb, 0, 1)
        bright = picture(2).rgb.max(axis=2) <= picture(2).alpha  # colours above 1 cannot be stored
        assert np.abs(over - wanted)[bright].max() < 2.1 / 255


def test_background(gscore, run_folder, tmp_path, picture):
    """Oracle: the rasterizer with that background; a run on white keeps white."""
    out = tmp_path / "out"
    gscore("render", run_folder(), "-o", out, "--view", "1", "--background", "0.2,0.4,1")
    np.testing.assert_array_equal(
        read(out / "a_1.png"), as_bytes(picture(1, background=(0.2, 0.4, 1.0)).rgb)
    )


def test_white_run_renders_on_white(gscore, run_folder, tmp_path, picture):
    """Oracle: the rasterizer on white."""
    gscore("render", run_folder(background="white"), "-o", tmp_path / "x.png", "--view", "1")
    np.testing.assert_array_equal(
        read(tmp_path / "x.png"), as_bytes(picture(1, background=(1.0, 1.0, 1.0)).rgb)
    )


def test_depth(gscore, run_folder, tmp_path, picture):
    """Oracle: the rasterizer's depth; 16 bits times the unit, and 32 bits exactly."""
    folder, wanted = run_folder(), picture(4).depth
    options = ("--view", "4", "--json", "--quiet")
    code, out, _ = gscore("render", folder, "-o", tmp_path / "a", "--depth", "png", *options)
    assert code == 0
    unit = json.loads(out)["depth_unit"]
    image = Image.open(tmp_path / "a" / "a_4_depth.png")
    assert image.mode == "I;16" and float(image.text["depth_unit"]) == unit
    np.testing.assert_allclose(np.asarray(image) * unit, wanted, atol=0.51 * unit)
    gscore("render", folder, "-o", tmp_path / "b", "--depth", "npy", *options)
    np.testing.assert_array_equal(np.load(tmp_path / "b" / "a_4_depth.npy"), wanted)
    assert 3 < wanted.max() < 8 and (wanted == 0).any()


def test_older_files_are_reported(gscore, run_folder, tmp_path):
    """Oracle: a depth map of an earlier rendering, which is not listed, and still exists."""
    folder, out = run_folder(), tmp_path / "a"
    code, reported, _ = gscore("render", folder, "-o", out, "--depth", "png", "--view", "4")
    assert code == 0 and "Other files" not in reported
    code, reported, _ = gscore("render", folder, "-o", out, "--view", "4")
    assert code == 0 and "Other files in the folder are kept: a_4_depth.png" in reported
    assert (out / "a_4_depth.png").is_file()


def test_deep(gscore, run_folder, tmp_path, picture):
    """Oracles: samples put over each other are the linear picture; those in front of an object are
    the rasterizer's picture of the splats in front of it, since each layer has one splat or two."""
    folder, seen = run_folder(), picture(4)
    options = ("--view", "4", "--quiet", "--background", "1,1,1")
    code, _, err = gscore("render", folder, "-o", tmp_path / "a", "--depth", "deep", *options)
    assert code == 0, err
    with OpenEXR.File(str(tmp_path / "a" / "a_4_depth.exr"), separate_channels=True) as file:
        assert file.header()["type"] == OpenEXR.deepscanline
        pixels = {name: channel.pixels for name, channel in file.channels().items()}
    z = picture(4).depth

    def flattened(farthest: float) -> np.ndarray:
        result = np.zeros((*z.shape, 4))
        for at in np.ndindex(z.shape):
            rest = 1.0
            for k, depth in enumerate([] if pixels["Z"][at] is None else pixels["Z"][at]):
                if depth <= farthest:
                    result[at] += rest * np.array([pixels[name][at][k] for name in "RGBA"])
                    rest *= 1 - float(pixels["A"][at][k])
        return result

    depths = [] if pixels["Z"][20, 20] is None else pixels["Z"][20, 20]
    assert all(np.diff(depths) > 0)
    alpha = seen.alpha[..., None]
    straight = seen.rgb / np.maximum(alpha, 1e-9)
    light = np.where(straight <= 0.04045, straight / 12.92, ((straight + 0.055) / 1.055) ** 2.4)
    whole = flattened(np.inf)
    np.testing.assert_allclose(whole[..., :3], light * alpha, atol=2e-3)
    np.testing.assert_allclose(whole[..., 3], seen.alpha, atol=4e-3)
    middle = float(np.median(z[z > 0]))
    front = picture(4, far=middle)
    assert 0.1 < (front.alpha > 0.1).mean() < (seen.alpha > 0.1).mean()
    off = np.abs(flattened(middle)[..., 3] - front.alpha)
    assert off.mean() < 0.01 and np.quantile(off, 0.9) < 0.02


def test_deep_with_levels_of_detail(gscore, run_folder, tmp_path):
    """Oracle: an error before anything is written."""
    lod = tmp_path / "a.lod"
    assert gscore("lod", run_folder(), "-o", lod, "--quiet")[0] == 0
    code, _, err = gscore(
        "render", lod, "-o", tmp_path / "out", "--depth", "deep", "--path", "orbit"
    )
    assert code == 2 and "without levels of detail" in err and not (tmp_path / "out").exists()


def test_depth_beyond_the_range_is_kept_apart_from_nothing(tmp_path):
    """Oracle: 0 for no depth, 1 for tiny depths, 65535 for too large ones."""
    depth = np.array([[0.0, 1e-9, 2.0], [3.0, 1e9, 0.0]], np.float32)
    write_depth_png(tmp_path / "d.png", depth, 0.001)
    np.testing.assert_array_equal(read(tmp_path / "d.png"), [[0, 1, 2000], [3000, 65535, 0]])


@pytest.mark.parametrize("kind", ["orbit", "spline"])
def test_path_to_pictures(gscore, run_folder, tmp_path, kind):
    """Oracle: the splats near the middle of every frame, and similar neighbours."""
    out = tmp_path / "out"
    code, _, _ = gscore(
        "render", run_folder(), "-o", out, "--path", kind, "--frames", "24", "--quiet"
    )
    assert code == 0
    names = sorted(p.name for p in out.iterdir())
    assert names == [f"frame_{i:05d}.png" for i in range(24)]
    frames = np.stack([read(out / name) for name in names]).astype(float)
    assert (frames[:, 12:24, 16:32].mean(axis=(1, 2, 3)) > 20).all()
    changes = np.abs(np.diff(frames, axis=0)).mean(axis=(1, 2, 3))
    assert 0 < changes.max() < 25


def test_video(gscore, run_folder, tmp_path, splats):
    """Oracle: the decoded frames of the file against the PNG files of the same path."""
    av = pytest.importorskip("av")
    folder = run_folder()
    shared = ("--path", "orbit", "--frames", "12", "-r", "24", "--quiet")
    gscore("render", folder, "-o", tmp_path / "frames", *shared)
    code, out, _ = gscore("render", folder, "-o", tmp_path / "v.mp4", "--fps", "12", *shared)
    assert code == 0 and "v.mp4: 12 pictures" in out
    with av.open(str(tmp_path / "v.mp4")) as file:
        stream = file.streams.video[0]
        assert stream.average_rate == 12 and stream.codec_context.pix_fmt == "yuv420p"
        frames = [f.to_ndarray(format="rgb24") for f in file.decode(video=0)]
    assert len(frames) == 12 and frames[0].shape == (18, 24, 3)
    for i, frame in enumerate(frames):
        still = read(tmp_path / "frames" / f"frame_{i:05d}.png").astype(float)
        # H.264 with half the colour resolution on a tiny, colourful picture.
        assert np.abs(frame - still).mean() < 14
        assert np.abs(frame - still[:, ::-1]).mean() > np.abs(frame - still).mean() + 5
    assert [p.name for p in tmp_path.iterdir() if p.name.endswith(".tmp")] == []


def facts_of_video(gscore, monkeypatch, folder, path, *options):
    """The facts that the verb prints for a video that is not written, and its messages."""
    monkeypatch.setattr("gscore.commands.render.write_video", lambda p, made, fps: len(list(made)))
    code, out, err = gscore("render", folder, "-o", path, "-r", "64", "--json", *options)
    assert code == 0
    return json.loads(out), err


def test_a_video_goes_around_by_itself(gscore, run_folder, tmp_path, cameras, monkeypatch):
    """Oracle: eight seconds of an orbit, and a sentence about it; chosen views as before."""
    pytest.importorskip("av")
    folder, path = run_folder(), tmp_path / "v.mp4"
    facts, err = facts_of_video(gscore, monkeypatch, folder, path, "--fps", "5")
    assert (facts["path"], facts["pictures"]) == ("orbit", 40)
    assert "Default path: an orbit around the focus of the cameras, 8.0 s." in err
    write_cameras(tmp_path / "sided.json", cameras.subset(range(4)))
    facts, err = facts_of_video(gscore, monkeypatch, folder, path, "-s", tmp_path / "sided.json")
    assert "Default path: a swing about the focus of the cameras, which lack a side" in err
    facts, err = facts_of_video(gscore, monkeypatch, folder, path, "--frames", "7", "--quiet")
    assert (facts["path"], facts["pictures"], err) == ("orbit", 7, "")
    facts, err = facts_of_video(gscore, monkeypatch, folder, path, "--all")
    assert (facts["path"], facts["pictures"]) == (None, 9) and "--path" not in err


def test_a_video_where_there_is_no_middle(gscore, run_folder, tmp_path, cameras, monkeypatch):
    """Oracle: cameras on a ring that face outwards: a spline from the first to the last."""
    pytest.importorskip("av")
    folder = run_folder()
    turned = np.diag([-1.0, 1.0, -1.0, 1.0]) @ cameras.viewmats
    write_cameras(folder / "cameras.json", replace(cameras, viewmats=turned))
    facts, err = facts_of_video(gscore, monkeypatch, folder, tmp_path / "v.mp4", "--fps", "4")
    assert (facts["path"], facts["pictures"]) == ("spline", 32)
    assert "a path through the cameras in their order" in err


def test_pictures_larger_than_the_photos(gscore, run_folder, tmp_path, picture):
    """Oracle: the picture of a camera with twice the focal length, sampled at its pixels."""
    code, out, _ = gscore(
        "render", run_folder(), "-o", tmp_path / "a.png", "--view", "4", "-r", "96", "--json"
    )
    facts = json.loads(out)
    assert code == 0 and (facts["width"], facts["height"]) == (96, 72)
    large = read(tmp_path / "a.png").astype(float)
    halved = large.reshape(36, 2, 48, 2, 3).mean(axis=(1, 3)) / 255
    assert np.abs(halved - np.clip(picture(4).rgb, 0, 1)).mean() < 0.02


def test_video_without_pyav(gscore, run_folder, tmp_path, monkeypatch):
    """Oracle: one sentence with the command that helps, before any work."""
    monkeypatch.setitem(sys.modules, "av", None)
    code, _, err = gscore("render", run_folder(), "-o", tmp_path / "v.mp4", "--path", "orbit")
    assert code == 2 and 'pip install "gscore[video]"' in err and not (tmp_path / "v.mp4").exists()


def test_broken_video_leaves_nothing(gscore, run_folder, tmp_path, monkeypatch):
    """Oracle: the folder after an error in the middle."""
    pytest.importorskip("av")
    folder = run_folder()

    def broken(*args, **options):
        raise ShapeError("no more")

    monkeypatch.setattr("gscore.commands.args.model_argument.ModelArgument.draw", broken)
    code, _, err = gscore("render", folder, "-o", tmp_path / "new" / "v.mp4", "--path", "orbit")
    assert code == 2 and "no more" in err and list((tmp_path / "new").iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--view", "b"], r"There is no view b; give one of 9 names such as a_0\.png"),
        (["--frames", "5"], "--frames needs --path"),
        (["--transparent", "--background", "white"], "either --transparent or --background"),
        (["--background", "pink"], "'pink' is not black, white or r,g,b"),
        (["-r", "12"], "resolution is 12"),
        (["-s", "nowhere"], "nowhere"),
        (["--path", "orbit", "--frames", "1"], "two frames"),
        (["--fps", "0"], "--fps must be above 0"),
        (["--sh-degree", "3"], "sh_degree must be 0 to 1"),
    ],
)
def test_bad_options(gscore, run_folder, tmp_path, arguments, says):
    """Oracle: exit code 2, one sentence, no output folder."""
    code, out, err = gscore("render", run_folder(), "-o", tmp_path / "out", *arguments)
    assert code == 2 and out == "" and re.search(says, err)
    assert "Traceback" not in err and not (tmp_path / "out").exists()


def test_bad_outputs_and_models(gscore, run_folder, tmp_path, splats):
    """Oracle: exit code 2 and a sentence with the path."""
    folder = run_folder()
    code, _, err = gscore("render", "-o", tmp_path / "out")
    assert code == 2 and "Give one model" in err
    code, _, err = gscore("render", folder, "-m", folder, "-o", tmp_path / "out")
    assert code == 2 and "Give one model" in err
    code, _, err = gscore("render", folder, "-o", tmp_path / "a.png")
    assert code == 2 and "9 views are selected" in err
    code, _, err = gscore("render", folder, "-o", tmp_path / "a.mp4", "--depth", "png")
    assert code == 2 and "neither transparency nor depth" in err
    code, _, err = gscore("render", tmp_path / "none", "-o", tmp_path / "out")
    assert code == 2 and "There is no file or folder" in err
    for name in ("x.txt", "x.gif", "x.mov", "x.spz", "x.html", "x.xyz", "x.m4v", "x.blend"):
        code, _, err = gscore("render", folder, "-o", tmp_path / name)
        assert code == 2 and "is not supported" in err and not (tmp_path / name).exists()
    assert gscore("render", folder, "-o", tmp_path / "take.v2", "--view", "0")[0] == 0
    write_splats(tmp_path / "none.ply", splats.subset(np.zeros(len(splats), bool)))
    code, _, err = gscore("render", tmp_path / "none.ply", "-s", folder, "-o", tmp_path / "out")
    assert code == 2 and "contains no splats to render" in err
    assert gscore("info", tmp_path / "none.ply")[1].startswith(f"{tmp_path / 'none.ply'}: 0 splats")
    empty = tmp_path / "empty"
    empty.mkdir()
    code, _, err = gscore("render", empty, "-o", tmp_path / "out")
    assert code == 2 and "expected point_cloud.ply" in err
    (folder / "cameras.json").unlink()
    code, _, err = gscore("render", folder, "-o", tmp_path / "out")
    assert code == 2 and "no cameras.json" in err
    (tmp_path / "file").write_text("")
    for output in ("file/x", "file/x/y.png", "file/v.mp4"):
        code, _, err = gscore("render", folder, "-o", tmp_path / output, "--path", "orbit")
        assert code == 2 and "file is a file; a folder is needed" in err


def test_picture_names_are_unique_and_inside_the_folder():
    """Oracle: names of photos in captures, with sub-folders, same stems and hostile paths."""
    assert still_names(["a/b.jpg", "c.JPG"]) == ["a/b", "c"]
    assert still_names(["x.jpg", "x.png"]) == ["x_jpg", "x_png"]
    assert still_names(["a\ud800b.png"]) == ["a_b"]
    assert still_names(["../../etc/x.jpg", "/abs/y.jpg", "C:\\z.jpg"]) == ["etc/x", "abs/y", "C_/z"]
    assert still_names(["A.jpg", "a.jpg", "b.jpg"]) == ["A_jpg", "a_jpg_1", "b"]
    assert still_names(["a.png", "a_depth.png"]) == ["a", "a_depth"]
    assert still_names(["a.png", "a_depth.png"], depths=True) == ["a", "a_depth_1"]
    odd = still_names(["", "..", "a.b.jpg", "same", "same"])
    assert len(set(odd)) == 5 and all(name and ".." not in name.split("/") for name in odd)


@pytest.mark.parametrize("where", ["{photos}", "{photos}/a_0.png", "{capture}"])
@pytest.mark.parametrize("given", [[], ["-s", "{capture}"]])
def test_photos_are_never_replaced(gscore, run_folder, capture, where, given):
    """Oracle: the photos, which have the names of the views."""
    folder, photos = run_folder(), capture / "images"
    before = {p: p.read_bytes() for p in capture.rglob("*.*") if p.is_file()}
    names = {"photos": photos, "capture": capture}
    line = [word.format(**names) for word in (*given, "-o", where, "--view", "0")]
    code, _, err = gscore("render", folder, *line, "--quiet")
    assert code == 2 and "where results would mix with" in err
    assert {p: p.read_bytes() for p in capture.rglob("*.*") if p.is_file()} == before

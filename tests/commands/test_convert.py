"""gscore convert: files, messages and refusals, against the functions behind it."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gscore.edit import contributions, most_important
from gscore.formats import read_splats as read_any
from gscore.formats.gltf import Gltf
from gscore.io.mesh.files import write_mesh
from gscore.io.ply.splats import MIP_COMMENT, header_comments, read_ply, write_splats
from gscore.metrics.image import psnr
from gscore.raster.api import render
from gscore.splats import Splats
from gscore.transforms import transform_splats


@pytest.fixture
def ply(tmp_path, splats):
    """The splats as a file outside any run."""
    path = tmp_path / "alone" / "some.ply"
    write_splats(path, splats)
    return path


def same(a, b):
    for name in ("means", "quats", "scales", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_without_options_nothing_changes(gscore, ply, tmp_path, splats):
    """Oracle: the splats to the bit; a message about the work; the file may be replaced."""
    out = tmp_path / "out.ply"
    for _ in range(2):
        code, text, _ = gscore("convert", ply, out)
        assert code == 0 and f"Wrote {out}: 60 splats, SH degree 1" in text
    same(read_ply(out), splats)


@pytest.mark.parametrize(
    ("line", "kept"), [("gscore up Z", "gscore up Z"), ("Vertical Axis: z", "up axis: Z")]
)
def test_the_axis_that_points_up_is_kept(gscore, ply, tmp_path, splats, line, kept):
    """Oracle: the comment of the input file; none once the splats were turned."""
    write_splats(ply, splats, comments=(line,))
    out = tmp_path / "out.ply"
    assert gscore("convert", ply, out)[0] == 0 and kept in header_comments(out)
    assert gscore("convert", ply, out, "--rotate", "90", "0", "0", "--overwrite")[0] == 0
    assert not any("up" in line for line in header_comments(out))


def test_a_proxy_goes_along(gscore, ply, tmp_path):
    """Oracle: the splats of a file without it to the bit, the vertices in glTF's axes; refusals
    write nothing."""
    mesh, out = tmp_path / "mesh.ply", tmp_path / "out.glb"
    vertices, corners = np.eye(3), np.array([[0, 1, 2]])
    write_mesh(mesh, vertices, corners)
    assert gscore("convert", ply, out, "--proxy", mesh)[0] == 0
    assert gscore("convert", ply, tmp_path / "without.glb")[0] == 0
    same(read_any(out), read_any(tmp_path / "without.glb"))
    file = Gltf(out)
    proxy = file.content["meshes"][1]["primitives"][0]
    places = file.numbers(proxy["attributes"]["POSITION"], "VEC3")
    np.testing.assert_array_equal(places, vertices * [-1, -1, 1])
    for name, more, words in (
        ("a.spz", (), "has no meshes"),
        ("a.glb", ("--scale", "2"), "not moved with the splats"),
        ("a.glb", ("--proxy", tmp_path / "none.ply"), "none.ply"),
    ):
        code, _, said = gscore("convert", ply, tmp_path / name, "--proxy", mesh, *more)
        assert code != 0 and words in said
        assert not (tmp_path / name).exists()


def with_harmonics(splats, rest):
    """The splats with this number of random coefficients."""
    rng = np.random.default_rng(3)
    shN = 0.1 * rng.standard_normal((len(splats), rest, 3), dtype=np.float32)
    return replace(splats, shN=shN)


def test_degree_4_goes_through_every_step(gscore, tmp_path, splats):
    """Oracle: the picture of splats joined and cropped by hand, from the same camera."""
    first, second = with_harmonics(splats, 24), with_harmonics(splats.subset(np.arange(9)), 15)
    write_splats(tmp_path / "a.ply", first)
    write_splats(tmp_path / "b.ply", second)
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = 2 * turn * np.linalg.det(turn), (1, 0, -3)
    (tmp_path / "matrix.txt").write_text(str(matrix.tolist()))
    away = np.linalg.norm(splats.means, axis=1)
    inside = away < np.median(away)
    code, text, _ = gscore(
        "convert", tmp_path / "a.ply", tmp_path / "c.ply", "--merge", tmp_path / "b.ply",
        "--sphere", 0, 0, 0, np.median(away), "--sh-degree", 4,
        "--matrix", tmp_path / "matrix.txt", "--json",
    )  # fmt: skip
    got, facts = read_ply(tmp_path / "c.ply"), json.loads(text)
    assert code == 0 and facts["sh_degree"] == facts["sh_degree_before"] == got.sh_degree == 4
    padded = replace(second, shN=np.pad(second.shN, ((0, 0), (0, 9), (0, 0))))
    parts = first.subset(inside), padded.subset(inside[:9])
    wanted = Splats(
        **{name: np.concatenate([getattr(p, name) for p in parts]) for name in vars(first)}
    )
    view, K = np.eye(4), np.array([[40.0, 0, 32], [0, 40, 24], [0, 0, 1]])
    view[2, 3] = 4
    turned = np.diag([2.0, 2, 2, 1]) @ view @ np.linalg.inv(matrix)
    old, new = (render(s, K, v, 64, 48).rgb for s, v in ((wanted, view), (got, turned)))
    assert len(got) == len(wanted) and old.max() > 0.1
    assert psnr(old, new) > 70
    assert psnr(old, render(wanted, K, view, 64, 48, sh_degree=3).rgb) < 60


@pytest.mark.parametrize(("name", "degree"), [("a.spz", 4), ("a.glb", 3), ("a.sog", 3)])
def test_degree_4_in_other_formats(gscore, tmp_path, splats, name, degree):
    """Oracle: the known content of each format; the loss is reported, and info lists the rest."""
    write_splats(tmp_path / "a.ply", with_harmonics(splats, 24))
    code, _, err = gscore("convert", tmp_path / "a.ply", tmp_path / name)
    assert code == 0 and ("stores colours up to SH degree 3" in err) == (degree < 4)
    code, text, _ = gscore("info", tmp_path / name, "--json")
    assert code == 0 and json.loads(text)["sh_degree"] == degree


def test_the_mark_of_antialiasing_stays(gscore, tmp_path, splats):
    """Oracle: the comments of the header; a message about mixed marks."""
    marked, plain = tmp_path / "a.ply", tmp_path / "b.ply"
    write_splats(marked, splats, comments=(MIP_COMMENT,))
    write_splats(plain, splats)
    code, _, err = gscore("convert", marked, tmp_path / "c.ply", "--merge", plain)
    assert code == 0 and MIP_COMMENT in header_comments(tmp_path / "c.ply")
    assert "and some without" in err
    gscore("convert", plain, tmp_path / "d.ply")
    assert MIP_COMMENT not in header_comments(tmp_path / "d.ply")


def test_count_and_error_of_a_run(gscore, run_folder, tmp_path, splats, capture, picture):
    """Oracle: ranks of contributions over the run's nine cameras; PSNR of renders by hand."""
    run = run_folder()
    code, text, _ = gscore("convert", run, tmp_path / "small.ply", "--count", 40, "--json")
    facts = json.loads(text)
    small = read_ply(tmp_path / "small.ply")
    from gscore.io.cameras_json import read_cameras_json

    cameras = read_cameras_json(run / "cameras.json")
    keep = most_important(contributions(splats, cameras), 40)
    assert code == 0 and facts["splats"] == 40 and facts["splats_before"] == 60
    assert [(step["name"], step["removed"]) for step in facts["steps"]] == [("count", 20)]
    same(small, splats.subset(keep))
    worths = []
    for K, viewmat in zip(cameras.Ks, cameras.viewmats, strict=True):
        a, b = (render(s, K, viewmat, 48, 36).rgb for s in (small, splats))
        worths.append(psnr(a, b))
    assert facts["error"]["psnr"] == pytest.approx(np.mean(worths))
    assert facts["error"]["worst_psnr"] == pytest.approx(min(worths))
    assert facts["error"]["worst"] == cameras.names[int(np.argmin(worths))]
    assert facts["error"]["views"] == 9 and facts["error"]["unchanged"] == 0
    assert facts["bytes"] == (tmp_path / "small.ply").stat().st_size < facts["bytes_before"]


def test_visible_thinning_warns(gscore, run_folder, tmp_path):
    """Oracle: the dB printed next to it."""
    run = run_folder()
    messages = {}
    for count in (1, 30, 45, 59):
        out = tmp_path / f"{count}.ply"
        code, text, err = gscore("convert", run, out, "--count", count, "--json")
        worth = json.loads(text)["error"]["psnr"]
        messages[worth < 30] = shows = f"--max-splats {count} looks better" in " ".join(err.split())
        assert code == 0 and shows == (worth < 30)
    assert messages == {True: True, False: False}, "both happen"


@pytest.mark.parametrize("source", ["capture", "run", "cameras.json"])
def test_cameras_of_every_kind(gscore, ply, tmp_path, run_folder, capture, source):
    """Oracle: the same kept splats, for every source of the cameras."""
    run = run_folder()
    named = {"capture": capture, "run": run, "cameras.json": run / "cameras.json"}[source]
    wanted = tmp_path / "wanted.ply"
    gscore("convert", run, wanted, "--count", 30)
    code, _, err = gscore("convert", ply, tmp_path / "got.ply", "--count", 30, "-s", named)
    assert code == 0 and "Warning" not in err
    same(read_ply(tmp_path / "got.ply"), read_ply(wanted))


def test_size_of_the_file(gscore, run_folder, tmp_path):
    """Oracle: the file."""
    code, _, _ = gscore("convert", run_folder(), tmp_path / "a.ply", "--size", 0.004)
    assert code == 0 and 3900 < (tmp_path / "a.ply").stat().st_size <= 4000


def test_frustum_by_name(gscore, run_folder, tmp_path, splats):
    """Oracle: projection by hand; the rest is the result of --outside."""
    from gscore.io.cameras_json import read_cameras_json

    run = run_folder(splats=replace(splats, means=splats.means * 4))
    cameras = read_cameras_json(run / "cameras.json")
    means = read_ply(run / "point_cloud.ply").means
    seen = means @ cameras.viewmats[3, :3, :3].T + cameras.viewmats[3, :3, 3]
    places = seen @ cameras.Ks[3].T
    x, y = places[:, 0] / seen[:, 2], places[:, 1] / seen[:, 2]
    inside = (seen[:, 2] > 0.01) & (x >= 0) & (x <= 48) & (y >= 0) & (y <= 36)
    assert 5 < inside.sum() < 55
    for view, more, wanted in (("a_3.png", [], inside), ("3", ["--outside"], ~inside)):
        code, _, _ = gscore("convert", run, tmp_path / "a.ply", "--frustum", view, *more)
        assert code == 0
        np.testing.assert_array_equal(read_ply(tmp_path / "a.ply").means, means[wanted])


def test_placed_at_last(gscore, run_folder, tmp_path, splats):
    """Oracle: transform_splats with the matrix of a file, and with the same in words; the error is
    measured before, in the world of the cameras."""
    matrix = np.eye(4)
    matrix[:3, :3] = [[0, 0, 2], [2, 0, 0], [0, 2, 0]]
    matrix[:3, 3] = 1, -2, 0.5
    file = tmp_path / "m.txt"
    file.write_text(str(matrix.tolist()))
    run = run_folder()
    code, text, _ = gscore("convert", run, tmp_path / "a.ply", "--matrix", file, "--json")
    assert code == 0 and json.loads(text)["error"] is None
    same(read_ply(tmp_path / "a.ply"), transform_splats(splats, matrix))
    words = ["--scale", 2, "--rotate", 90, 0, 90, "--move", 1, -2, 5e-1]
    gscore("convert", run, tmp_path / "b.ply", *words)
    moved = read_ply(tmp_path / "b.ply")
    np.testing.assert_allclose(moved.means, transform_splats(splats, matrix).means, atol=1e-5)


def test_clean_is_not_seen(gscore, run_folder, tmp_path, splats):
    """Oracle: ten invisible splats added to the scene; they are removed, and hardly any other."""
    n = len(splats)
    rows = np.concatenate([np.arange(n), np.arange(10)])
    dusty = splats.subset(rows)
    opacities, means, scales = dusty.opacities.copy(), dusty.means.copy(), dusty.scales.copy()
    opacities[n : n + 5] = -8
    means[n + 5 :] = np.linspace(30, 90, 5)[:, None]
    scales[n + 5 :] = -4
    dusty = replace(dusty, opacities=opacities, means=means, scales=scales)
    run = run_folder(splats=dusty)
    code, text, _ = gscore("convert", run, tmp_path / "a.ply", "--clean", "--json")
    facts = json.loads(text)
    names = [step["name"] for step in facts["steps"]]
    assert code == 0 and names == ["opacity", "contribution", "isolation"]
    assert 55 <= facts["splats"] <= 60
    assert facts["error"]["psnr"] is None or facts["error"]["psnr"] > 50


def test_picture_before_and_after(gscore, run_folder, tmp_path, splats, picture):
    """Oracle: both halves, which are renders bit for bit; one picture also without cameras."""
    out, png = tmp_path / "a.ply", tmp_path / "p.png"
    run = run_folder()
    words = ["--count", 20, "--picture", png, "--picture-view", "a_2"]
    code, _, _ = gscore("convert", run, out, *words)
    made = np.asarray(Image.open(png))
    assert code == 0 and made.shape == (36, 48 * 2 + 8, 3)
    wanted = (np.clip(picture(2).rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
    np.testing.assert_array_equal(made[:, :48], wanted)
    assert (made[:, 48:56] == 255).all() and (made[:, 56:] != wanted).any()
    lone = tmp_path / "lone" / "s.ply"
    write_splats(lone, splats)
    code, _, _ = gscore("convert", lone, out, "--picture", png)
    made = np.asarray(Image.open(png))
    assert code == 0 and made[:, :960].max() > 100
    np.testing.assert_array_equal(made[:, :960], made[:, 968:])


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--box", 50, 50, 50, 60, 60, 60], "would leave none of 60 splats"),
        (["--box", 1, 1, 1, 0, 0, 0], "lower corner first"),
        (["--sphere", 0, 0, 0, "-1e-2"], "radius of a sphere must be above 0"),
        (["--sphere", 0, 0, "nan", 1], "is not a number"),
        (["--outside"], "needs a shape"),
        (["--min-opacity", 1.5], "number from 0 to 1"),
        (["--count", 0], "whole number from 1"),
        (["--count", "2.5"], "whole number from 1"),
        (["--count", 5, "--size", 1], "not allowed with"),
        (["--size", "inf"], "number above 0"),
        (["--scale", 0], "number above 0"),
        (["--frustum", "a_1"], "with -s"),
        (["--min-contribution", 1], "with -s"),
        (["--picture", "x.jpg"], "is a PNG"),
        (["--picture-view", "3"], "belongs to --picture"),
        (["--matrix", "there_is_none.txt"], "Cannot read"),
        (["-s", "nowhere"], "nowhere"),
        (["--merge", "nowhere.ply"], "nowhere.ply"),
    ],
)
def test_bad_words_are_refused(gscore, ply, tmp_path, words, sentence):
    """Oracle: exit code 2 and the sentence; no files."""
    code, _, err = gscore("convert", ply, tmp_path / "out.ply", *words)
    assert code == 2 and sentence in " ".join(err.split())
    assert not (tmp_path / "out.ply").exists()


def test_a_text_that_is_no_matrix(gscore, ply, tmp_path):
    """Oracle: the sentence; a shear is refused too."""
    file = tmp_path / "m.txt"
    for text, words in (("1 2 3", "16 numbers"), ("1 1 0 0 0 1 0 0 0 0 1 0 0 0 0 1", "unevenly")):
        file.write_text(text)
        code, _, err = gscore("convert", ply, tmp_path / "out.ply", "--matrix", file)
        assert code == 2 and words in err
        assert not (tmp_path / "out.ply").exists()


def test_inputs_and_other_files_are_kept(gscore, ply, tmp_path):
    """Oracle: unchanged input, and unchanged files of other programs."""
    before = ply.read_bytes()
    code, _, err = gscore("convert", ply, ply, "--overwrite")
    assert code == 2 and "is an input file" in err and ply.read_bytes() == before
    other = tmp_path / "other.ply"
    other.write_text("mine")
    code, _, err = gscore("convert", ply, other)
    assert code == 2 and "without a mark of" in err and other.read_text() == "mine"
    assert gscore("convert", ply, other, "--overwrite")[0] == 0
    code, _, err = gscore("convert", ply, tmp_path / "a.xyz")
    assert code == 2 and "no format of splats has this ending" in err


@pytest.mark.parametrize("ending", [".splat", ".spz", ".sog", ".glb", ".compressed.ply"])
def test_formats_by_their_ending(gscore, run_folder, tmp_path, splats, ending):
    """Oracle: a thinned model in the file, and the error of the file: its renders against those of
    the run, by hand."""
    from gscore.io.cameras_json import read_cameras_json

    run, out = run_folder(), tmp_path / f"a{ending}"
    code, text, err = gscore("convert", run, out, "--json")
    facts = json.loads(text)
    assert code == 0, err
    back = read_any(out)
    assert facts["splats"] == len(back) == 60 and facts["bytes"] == out.stat().st_size
    cameras = read_cameras_json(run / "cameras.json")
    worths = []
    for K, viewmat in zip(cameras.Ks, cameras.viewmats, strict=True):
        a, b = (render(s, K, viewmat, 48, 36).rgb for s in (back, splats))
        worths.append(psnr(a, b))
    if ending != ".glb":
        assert 20 < facts["error"]["psnr"] < 80
        assert facts["error"]["psnr"] == pytest.approx(np.mean(worths))
    assert facts["sh_degree"] == back.sh_degree
    if ending == ".splat":
        assert any("SH degree 0" in sentence for sentence in facts["warnings"])
    code, text, err = gscore("convert", out, tmp_path / "again.ply", "--count", 30, "--json")
    assert code == 0 and json.loads(text)["format"] == "ply"
    assert len(read_ply(tmp_path / "again.ply")) == 30


def test_size_of_a_packed_file(gscore, run_folder, tmp_path):
    """Oracle: the file, for any coding of the number of splats."""
    code, _, err = gscore("convert", run_folder(), tmp_path / "a.spz", "--size", 0.0012)
    assert code == 0, err
    assert 900 < (tmp_path / "a.spz").stat().st_size <= 1200


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["--scale", "1e308"], "above 0 and up to 1e+30"),
        (["--move", "1e308", "0", "0"], "from -1e+30 to 1e+30"),
        (["--max-size", "1e308"], "above 0 and up to 1e+30"),
        (["--box", "-1e308", "-1", "-1", "1e308", "1", "1"], "from -1e+30 to 1e+30"),
        (["--sphere", "0", "0", "0", "1e308"], "from -1e+30 to 1e+30"),
        (["--move", "nan", "0", "0"], "'nan' is not a number from -1e+30 to 1e+30"),
        (["--scale", "1e30", "--move", "1e30", "0", "0"], ""),
    ],
)
def test_numbers_that_leave_no_room(gscore, ply, tmp_path, recwarn, more, sentence):
    """Oracle: exit 2 and one sentence, or a file; no numpy warnings in either case."""
    code, _, err = gscore("convert", ply, tmp_path / "o.ply", *more)
    assert code == (2 if sentence else 0) and sentence in err
    assert (tmp_path / "o.ply").exists() == (not sentence)
    assert not [one for one in recwarn if issubclass(one.category, RuntimeWarning)]


def test_repeated_files_warn(gscore, ply, tmp_path):
    """Oracle: a warning that names the file, under any of its names; all splats."""
    link = tmp_path / "link.ply"
    link.symlink_to(ply)
    code, text, err = gscore("convert", ply, tmp_path / "o.ply", "--merge", link, ply, "--json")
    assert code == 0 and f"{ply} is given 3 times" in err.replace("\n", " ")
    assert json.loads(text)["splats"] == 180
    _, text, _ = gscore("convert", ply, tmp_path / "o.ply", "--merge", link)
    assert "; before: 60 + 60 splats, SH degree 1, " in text


def test_views_without_a_loss_warn(gscore, ply, run_folder, tmp_path):
    """Oracle: warnings with the reason where no picture is compared, none where some are."""
    run, output = run_folder(), tmp_path / "o.ply"
    for source, more, said in (
        (ply, ["--min-opacity", 0.6], "--views has no effect: there are no cameras"),
        (run, [], "--views has no effect: no splat changed"),
        (run, ["--min-opacity", 0.6], ""),
    ):
        code, _, err = gscore("convert", source, output, "--views", 2, *more)
        assert code == 0 and (said in err if said else "--views" not in err), err


def test_option_of_another_format_warns(gscore, ply, tmp_path):
    """Oracle: a warning where the option has no effect, and none where it has one."""
    for name, messages in (("o.ply", True), ("o.spz", False)):
        _, _, err = gscore("convert", ply, tmp_path / name, "--spz-version", 4)
        assert ("--spz-version has no effect" in err) == messages


@pytest.mark.parametrize("verb", ["convert", "view", "render", "info"])
def test_pipes_and_devices_are_called_so(gscore, tmp_path, verb):
    """Oracle: their kind, immediately; no wait for a pipe without a writer."""
    os.mkfifo(tmp_path / "pipe.ply")
    for path, what in ((tmp_path / "pipe.ply", "a named pipe"), ("/dev/zero", "a device")):
        page, folder = ["-o", tmp_path / "o.html"], ["-o", tmp_path / "o"]
        rest = {"convert": [tmp_path / "o.ply"], "view": page, "render": folder}.get(verb, [])
        code, _, err = gscore(verb, path, *rest)
        assert code == 2 and what in err


def test_files_that_hold_no_name_stay(gscore, ply, tmp_path):
    """Oracle: a file written by gscore without a mark; the sentence is true of it."""
    out = tmp_path / "o.spz"
    assert gscore("convert", ply, out)[0] == 0
    code, _, err = gscore("convert", ply, out, "--count", 5)
    assert code == 2 and "without a mark of" in err and "did not write" not in err
    assert len(read_any(out)) == 60
    assert gscore("convert", ply, out, "--count", 5, "--overwrite")[0] == 0


@pytest.mark.parametrize("option", ["-o", "--output"])
def test_an_output_option_is_refused_with_the_usage(gscore, ply, tmp_path, option):
    """Oracle: exit 2 and the sentence."""
    code, _, err = gscore("convert", ply, option, tmp_path / "o.ply")
    assert code == 2
    assert f"the output is an argument, without {option}: gscore convert IN OUT" in err
    assert not (tmp_path / "o.ply").exists()


def test_more_threads_than_cores_warn(gscore, ply, tmp_path, monkeypatch):
    """Oracle: the warning with 3 of 2 cores, and none with 2."""
    monkeypatch.setattr("gscore.metrics.machine.cores", lambda: 2)
    for threads in (3, 2, "auto"):
        code, _, err = gscore(
            "convert", ply, tmp_path / "o.ply", "--overwrite", "--threads", threads
        )
        assert code == 0
        assert ("--threads 3: this machine has 2 cores" in err) == (threads == 3)

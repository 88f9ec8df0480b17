"""gscore lod and the verbs that read its files. Oracle: the splats of the run, and renders of
them."""

import json

import numpy as np
import pytest
from PIL import Image

from gscore.io.lod_file import open_lod_file
from gscore.io.ply.splats import MIP_COMMENT, header_comments, read_ply, write_splats
from gscore.lod import groups
from gscore.metrics.image import psnr


@pytest.fixture
def city(gscore, run_folder, tmp_path, monkeypatch):
    """The run's 60 splats in two levels."""
    monkeypatch.setattr(groups, "MOST_IN_A_CHUNK", 30)
    run = run_folder()
    assert gscore("lod", run, "-o", tmp_path / "city.lod", "--quiet") == (0, "", "")
    return tmp_path / "city.lod"


def test_lod_says_what_each_level_has(gscore, run_folder, tmp_path, monkeypatch):
    """Oracle: the file's own index; the same in `info`, also as JSON."""
    monkeypatch.setattr(groups, "MOST_IN_A_CHUNK", 30)
    run, out = run_folder(), tmp_path / "city.lod"
    code, text, err = gscore("lod", run, "-o", out)
    assert code == 0 and not err
    assert "60 splats with 2 levels of detail" in text and " dB against level 0" in text
    assert gscore("info", out) == (0, text, "")
    facts = json.loads(gscore("lod", run, "-o", out, "--json")[1])
    assert json.loads(gscore("info", out, "--json")[1]) == {
        k: v for k, v in facts.items() if k != "warnings"
    }
    with open_lod_file(out) as file:
        index = file.index
    assert (
        [level["splats"] for level in facts["levels"]]
        == [60, 15]
        == [level.splats for level in index.levels]
    )
    assert facts["cameras"] == 9 and facts["storage_bytes"] == out.stat().st_size


def test_render_takes_it_with_its_cameras(gscore, city, run_folder, tmp_path):
    """Oracle: the pictures of the run at the finest level; a coarse picture is near them, and JSON
    states its number of splats."""
    run = tmp_path / "run"
    view = ("--view", "a_3")
    gscore("render", run, "-o", tmp_path / "whole.png", *view, "--quiet")
    made = gscore("render", city, "-o", tmp_path / "fine.png", *view, "--lod-px", 0, "--json")
    fine = json.loads(made[1])
    made = gscore("render", city, "-o", tmp_path / "far.png", *view, "--lod-px", 1e6, "--json")
    coarse = json.loads(made[1])
    assert (fine["splats_drawn"], coarse["splats_drawn"]) == (60, 15)
    assert fine["splats"] == 60 and fine["chunks_by_level"] == [4, 0]
    whole, near, far = (
        np.asarray(Image.open(tmp_path / f"{name}.png"), int) for name in ("whole", "fine", "far")
    )
    assert np.abs(whole - near).max() <= 1
    assert 15 < psnr(far.astype(np.uint8), whole.astype(np.uint8)) < 50
    made = gscore("render", city, "-o", tmp_path / "few.png", *view, "--lod-splats", 20, "--json")
    assert json.loads(made[1])["splats_drawn"] == 15


def test_a_video_of_it(gscore, city, tmp_path):
    """Oracle: the number of pictures of an orbit around the cameras in the file."""
    pytest.importorskip("av")
    words = ("--path", "orbit", "--frames", 3, "--json")
    code, text, _ = gscore("render", city, "-o", tmp_path / "orbit.mp4", *words)
    assert code == 0 and json.loads(text)["pictures"] == 3


def test_convert_writes_a_level_or_a_box(gscore, city, splats, tmp_path):
    """Oracle: the splats of the run, those in the box to the bit; the level's number."""
    assert gscore("convert", city, tmp_path / "all.ply", "--quiet")[0] == 0
    found = read_ply(tmp_path / "all.ply")
    order_of = [np.lexsort(one.means.T) for one in (found, splats)]
    np.testing.assert_array_equal(found.means[order_of[0]], splats.means[order_of[1]])
    np.testing.assert_array_equal(found.shN[order_of[0]], splats.shN[order_of[1]])
    gscore("convert", city, tmp_path / "few.ply", "--level", 1, "--quiet")
    assert len(read_ply(tmp_path / "few.ply")) == 15
    box = ("--box", -0.2, -1, -1, 0.6, 1, 0.5)
    _, text, _ = gscore("convert", city, tmp_path / "box.ply", *box, "--quiet")
    low, high = np.array(box[1:4]), np.array(box[4:])
    inside = ((splats.means >= low) & (splats.means <= high)).all(axis=1)
    found = read_ply(tmp_path / "box.ply").means
    assert 5 < inside.sum() < 55
    assert f"; read: {inside.sum()} splats, " in text  # the number of the whole level is unknown
    assert sorted(map(tuple, found)) == sorted(map(tuple, splats.means[inside]))
    gscore("convert", city, tmp_path / "out.ply", *box, "--outside", "--quiet")
    assert len(read_ply(tmp_path / "out.ply")) == 60 - inside.sum()


def test_antialiasing_stays_with_it(gscore, splats, tmp_path):
    """Oracle: the comment of the PLY converted back from it."""
    write_splats(tmp_path / "a.ply", splats, comments=(MIP_COMMENT,))
    gscore("lod", tmp_path / "a.ply", "-o", tmp_path / "a.lod", "--quiet")
    assert "trained with antialiasing" in gscore("info", tmp_path / "a.lod")[1]
    gscore("convert", tmp_path / "a.lod", tmp_path / "b.ply", "--quiet")
    assert MIP_COMMENT in header_comments(tmp_path / "b.ply")


def refuses(gscore, sentence, *arguments):
    """One sentence, code 2."""
    code, _, err = gscore(*arguments)
    assert code == 2 and sentence in err and err.count("\n") == 1, err


def test_invalid_calls_are_refused(gscore, city, tmp_path):
    """Oracle: a sentence each, and no file."""
    run, new = tmp_path / "run", tmp_path / "new"
    refuses(gscore, "the output is a .lod file", "lod", run, "-o", tmp_path / "new.ply")
    refuses(gscore, "contains levels of detail already", "lod", city, "-o", tmp_path / "new.lod")
    refuses(gscore, "no file or folder", "lod", tmp_path / "gone", "-o", tmp_path / "new.lod")
    refuses(gscore, "--lod-px must be 0 or more", "render", city, "-o", new, "--lod-px", -1)
    refuses(gscore, "--lod-px must be 0 or more", "render", city, "-o", new, "--lod-px", "nan")
    refuses(gscore, "--lod-splats", "render", city, "-o", new, "--lod-splats", 0)
    refuses(gscore, "has none. Build them first", "render", run, "-o", new, "--lod-px", 1)
    refuses(gscore, "has 2 levels", "convert", city, tmp_path / "new.ply", "--level", 2)
    refuses(gscore, "has none", "convert", run, tmp_path / "new.ply", "--level", 0)
    gone = ("convert", tmp_path / "gone.ply", tmp_path / "new.ply", "--level", 0)
    refuses(gscore, "There is no file or folder", *gone)
    refuses(gscore, "is a file of levels of detail", "view", city, "-o", tmp_path / "new.html")
    refuses(gscore, "is a file of levels of detail", "eval", city, "-o", new)
    city.write_bytes(city.read_bytes()[:-1])
    for verb in (("info", city), ("render", city, "-o", new), ("convert", city, "new.ply")):
        refuses(gscore, "city.lod is truncated or damaged", *verb)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["city.lod", "run"]


def test_replaced_files(gscore, city, tmp_path):
    """Oracle: a user's file, which stays without --overwrite; its own are replaced."""
    run = tmp_path / "run"
    (tmp_path / "mine.lod").write_bytes(b"my notes")
    refuses(gscore, "so it is kept", "lod", run, "-o", tmp_path / "mine.lod")
    assert (tmp_path / "mine.lod").read_bytes() == b"my notes"
    before = city.read_bytes()
    assert gscore("lod", run, "-o", city, "--quiet")[0] == 0
    assert gscore("lod", run, "-o", tmp_path / "mine.lod", "--overwrite", "--quiet")[0] == 0
    assert city.read_bytes() == before == (tmp_path / "mine.lod").read_bytes()

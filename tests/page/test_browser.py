"""The page in Chromium, with software GL; oracle: `gscore.render` from the same camera."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore import Splats, render
from gscore.commands.args.model_argument import open_model
from gscore.commands.pictures.page_views import _without_cameras
from gscore.config import Background
from gscore.io.ply.splats import MIP_COMMENT, write_splats
from gscore.page.pack import pack, unpack
from gscore.page.page import Page, PageCamera, most_splats, write_page
from tests.page.chromium import Chromium, find_chromium
from tests.page.test_pack import cloud

SIZE = (160, 120)
MOST = 3.0
"""Mean difference, 8-bit values, that the page may have to the original."""


def camera(number: int = 0) -> PageCamera:
    """One of some that look at the sheet askew; its principal point is off the centre."""
    angle = 0.5 * number
    forward = np.array([0.3 * np.sin(angle), 0.2, 1.0])
    forward /= np.linalg.norm(forward)
    right = np.cross([0, 1.0, 0], forward)
    right /= np.linalg.norm(right)
    viewmat = np.eye(4)
    viewmat[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    viewmat[2, 3] = 1.9
    width, height = SIZE
    K = np.array([[150.0, 0, width / 2 + 6], [0, 140, height / 2 - 4], [0, 0, 1]])
    name = f"view {number}"
    return PageCamera(name=name, label=name, viewmat=viewmat, K=K, width=width, height=height)


def written(folder: Path, splats: Splats, **changes) -> tuple[Path, Page]:
    """A page of these splats."""
    cameras = [camera(i) for i in range(3)]
    page = Page(
        title="A <b> & </script> title",
        splats=pack(splats),
        cameras=cameras,
        first=cameras[1],
        focus=np.zeros(3),
        up=np.array([0, -1.0, 0]),
        background=(0.2, 0.4, 0.1),
        near=0.01,
        antialias=False,
        facts="x",
    )
    page = replace(page, **changes)
    write_page(folder / "a.html", page)
    return folder / "a.html", page


def rendered(splats: Splats, page: Page, number: int) -> np.ndarray:
    """[H, W, 3] float, 0 to 255."""
    one = page.cameras[number]
    drawn = render(
        splats, one.K, one.viewmat, *SIZE, background=page.background, antialias=page.antialias
    )
    return np.clip(drawn.rgb, 0, 1) * 255


def shown(browser: Chromium, path: Path, number: int) -> np.ndarray:
    """[H, W, 3] float: the canvas, at the size of the cameras."""
    browser.size(*SIZE)
    browser.open(path)
    browser.value(f"viewer.show({number})")
    return browser.canvas().astype(float)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("antialias", [False, True])
def test_pictures_are_those_of_the_rasterizer(browser, tmp_path, degree, antialias):
    """Oracle: `render`, of the same numbers within 1/255, of the original within 3/255."""
    splats = cloud(1500, degree)
    # Some below the size of a pixel and some needles, which are drawn by the same formulas.
    scales = splats.scales + np.where(np.arange(1500) % 4 == 0, -3, 1)[:, None].astype(np.float32)
    scales[::7, 0] += 1.5
    splats = replace(splats, scales=scales.astype(np.float32))
    path, page = written(tmp_path, splats, antialias=antialias)
    for number in (0, 2):
        found = shown(browser, path, number)
        same = np.abs(found - rendered(unpack(page.splats), page, number))
        assert same.mean() < 1.0 and np.percentile(same, 99) < 4
        original = np.abs(found - rendered(splats, page, number))
        assert original.mean() < MOST
        assert np.ptp(found) > 100  # something is there
    assert browser.complaints() == []


def test_far_splats_stay_separate(browser, tmp_path):
    """Oracle: `render` of the splats as they were; blocks of a page are of any length then."""
    splats = cloud(1500, 1)
    splats.means[::100] *= np.array([[3e4, -1e5, -1e6]], np.float32)
    splats.means[::100, 2] = -1e6  # behind all cameras
    path, page = written(tmp_path, splats)
    assert page.splats.head["blocks"] > 6
    found = shown(browser, path, 2)
    assert np.abs(found - rendered(splats, page, 2)).mean() < MOST


def test_a_photo_is_there_once(tmp_path):
    """Oracle: the text of the page, of whose cameras one is the first view; and of another one."""
    photo = "data:image/jpeg;base64,UGhvdG8="
    cameras = [replace(camera(i), photo=photo if i == 1 else "") for i in range(3)]
    for first in (cameras[1], replace(camera(1), photo=photo)):
        path, _ = written(tmp_path, cloud(50, 0), cameras=cameras, first=first)
        assert path.read_text().count(photo) == (1 if first is cameras[1] else 2)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_as_many_splats_as_a_texture_holds(degree):
    """Oracle: the texels that unpack.js gives a splat, by its own text, in 16,384 rows of 2,048."""
    script = Path("gscore/page/unpack.js").read_text()
    assert "2 + Math.ceil((3 * ((degree + 1) ** 2 - 1)) / 16)" in script
    texels = 2 + math.ceil(3 * ((degree + 1) ** 2 - 1) / 16)
    assert most_splats(degree) * texels <= 2048 * 16384 < (most_splats(degree) + 1) * texels


def test_order_decides(browser, tmp_path):
    """Oracle: of two opaque splats the near one is seen, from both sides."""
    splats = cloud(2, 0)
    wide = np.full((2, 3), -1.0, np.float32)
    red_behind = np.array([[[1.5, -1.5, -1.5]], [[-1.5, -1.5, 1.5]]], np.float32)
    splats = replace(
        splats,
        means=np.array([[0, 0, 0.4], [0, 0, -0.4]], np.float32),
        scales=wide,
        opacities=np.full(2, 8, np.float32),
        sh0=red_behind,
    )
    path, _ = written(tmp_path, splats)
    height, width = SIZE[1] // 2, SIZE[0] // 2
    front = shown(browser, path, 0)[height, width]
    assert front[2] > 200 > 60 > front[0]
    browser.value("viewer.eye.orbit(Math.PI, 0); viewer.change()")
    back = browser.canvas()[height, width]
    assert back[0] > 200 > 60 > back[2]


def test_a_frame_is_one_call(browser, tmp_path):
    """Oracle: what WebGL is asked for, counted: one drawing a frame, and bytes only after a sort,
    four a splat."""
    path, page = written(tmp_path, cloud(5000, 3))
    browser.open(path)
    browser.canvas()
    calls, idle, after = browser.value("""(async () => {
      const gl = viewer.canvas.getContext('webgl2');
      let calls = 0, bytes = 0;
      for (const name of Object.getOwnPropertyNames(WebGL2RenderingContext.prototype)) {
        if (!/^(draw(A|E)|buffer(D|S)|texImage|texSub)/.test(name)) continue;
        const real = gl[name].bind(gl);
        gl[name] = (...given) => {
          if (name.startsWith('draw')) calls++;
          for (const one of given) bytes += (one && one.byteLength) || 0;
          return real(...given);
        };
      }
      for (let k = 0; k < 3; k++) viewer.frame(performance.now() + 1e6);
      const idle = bytes;
      viewer.sorted = -1;
      await viewer.settled();
      return [calls, idle, bytes];
    })()""")
    assert idle == 0 and 3 <= calls <= 6, "three frames, and those until the order is there"
    assert 0 < after <= 4 * page.splats.head["count"]


def test_page_loads_no_other_resources(browser, tmp_path):
    """Oracle: Chromium's own list of requests, and addresses in the text."""
    path, _ = written(tmp_path, cloud(300, 1))
    browser.open(path)
    browser.canvas()
    assert browser.complaints() == []
    text = path.read_text()
    assert not re.findall(r"https?://|//[a-z]+\.", text)
    assert "default-src 'none'" in text
    assert browser.value("document.title") == "A <b> & </script> title"


def test_the_view_follows_hands_and_keys(browser, tmp_path):
    """Oracle: where the camera is and what it turns about, before and after each gesture."""
    path, _ = written(tmp_path, cloud(300, 0))
    browser.size(600, 400)
    browser.open(path)
    state = "({p: viewer.eye.position, r: viewer.eye.rotation, f: viewer.eye.focus, at: viewer.at})"

    def after(act) -> tuple[dict, dict]:
        browser.value("viewer.home()")
        before = browser.value(state)
        act()
        return before, browser.value(state)

    def distance(one: dict) -> float:
        return float(np.linalg.norm(np.subtract(one["p"], one["f"])))

    before, found = after(lambda: browser.drag((300, 150), (400, 180)))
    assert found["f"] == before["f"] and distance(found) == pytest.approx(distance(before))
    assert np.abs(np.subtract(found["p"], before["p"])).max() > 0.1
    assert np.array(found["r"]) @ np.array(found["r"]).T == pytest.approx(np.eye(3), abs=1e-9)

    before, found = after(lambda: browser.drag((300, 150), (360, 150), button="right"))
    assert found["r"] == before["r"] and found["f"] != before["f"]

    def wheel() -> None:
        browser.mouse("mouseWheel", 300, 150, deltaX=0, deltaY=-200)

    before, found = after(wheel)
    assert distance(found) < 0.8 * distance(before)

    def pinch() -> None:
        browser.touch("touchStart", (250, 150), (350, 150))
        browser.touch("touchMove", (200, 150), (400, 150))
        browser.touch("touchEnd")

    before, found = after(pinch)
    assert distance(found) == pytest.approx(distance(before) / 2, rel=0.02)

    before, found = after(lambda: browser.key("ArrowRight"))
    assert (before["at"], found["at"]) == (1, 2)

    def fly() -> None:
        browser.key("f")
        browser.drag((300, 150), (400, 180))
        browser.key("f")

    before, found = after(fly)
    assert found["p"] == before["p"] and found["r"] != before["r"]
    # What was under the mouse stays under it: to the right and down means looking left and up.
    assert np.dot(before["r"][0], found["r"][2]) < 0 > np.dot(before["r"][1], found["r"][2])

    def walk() -> None:
        browser.call("Input.dispatchKeyEvent", type="keyDown", key="w")
        browser.value("new Promise((done) => setTimeout(done, 400))")
        browser.call("Input.dispatchKeyEvent", type="keyUp", key="w")

    before, found = after(walk)
    way = np.subtract(found["p"], before["p"])
    assert np.dot(way, before["r"][2]) > 0.9 * np.linalg.norm(way) > 0
    assert browser.complaints() == []


def test_dragging_moves_what_is_seen_along(browser, tmp_path):
    """Oracle: one splat in front of the focus; it follows the mouse to the right and down."""
    one = cloud(1, 0)
    one = replace(
        one,
        means=np.array([[0.0, 0, -0.6]], np.float32),
        scales=np.full((1, 3), -3, np.float32),
        opacities=np.full(1, 8, np.float32),
    )
    path, _ = written(tmp_path, one, background=(0.0, 0, 0))
    browser.size(400, 300)
    browser.open(path)

    def middle() -> np.ndarray:
        rows, columns = np.nonzero(browser.canvas().sum(axis=2) > 30)
        return np.array([columns.mean(), rows.mean()])

    browser.value("viewer.show(0)")
    before = middle()
    browser.drag((200, 150), (230, 150))
    right = middle()
    assert right[0] > before[0] + 5
    browser.drag((200, 150), (200, 180))
    assert middle()[1] > right[1] + 5


def test_a_window_of_another_size_is_filled(browser, tmp_path):
    """Oracle: the sizes of canvas and window; the picture of the camera lies in the middle."""
    path, _ = written(tmp_path, cloud(1500, 0))
    original = shown(browser, path, 0)
    browser.size(2 * SIZE[0] + 80, 2 * SIZE[1])
    found = browser.canvas().astype(float)
    assert found.shape == (2 * SIZE[1], 2 * SIZE[0] + 80, 3)
    inner = found[:, 40:-40].reshape(SIZE[1], 2, SIZE[0], 2, 3).mean(axis=(1, 3))
    assert np.abs(inner - original).mean() < 6
    browser.size(90, 160, phone=True)
    assert browser.canvas().shape == (320, 180, 3)
    browser.size(*SIZE)


def test_without_webgl_the_page_says_so(tmp_path, tmp_path_factory):
    """Oracle: a Chromium without any 3D."""
    program = find_chromium()
    if program is None:
        pytest.skip("no Chromium here; Debian has it as the package chromium")
    path, _ = written(tmp_path, cloud(10, 0))
    with Chromium(program, tmp_path_factory.mktemp("plain"), gl=False) as plain:
        plain.open(path, until="document.getElementById('message').textContent.includes('WebGL')")
        assert "hardware acceleration" in plain.value("document.body.innerText")


def test_lost_context_is_reported_and_restored(browser, tmp_path):
    """Oracle: WEBGL_lose_context, and the picture before."""
    path, _ = written(tmp_path, cloud(1500, 2))
    before = shown(browser, path, 0)
    reported = "document.getElementById('message').textContent"
    browser.value("window.loss = viewer.renderer.gl.getExtension('WEBGL_lose_context')")
    browser.value("loss.loseContext(); new Promise((done) => setTimeout(done, 300))")
    assert "connection to the graphics card was lost" in browser.value(reported)
    browser.value("loss.restoreContext(); new Promise((done) => setTimeout(done, 500))")
    assert browser.value(reported) == ""
    assert np.array_equal(browser.canvas(), before)


def test_a_run_becomes_a_page(gscore, run_folder, splats, browser):
    """Oracle: the run's splats and cameras, its photos, the line on stdout and the report."""
    folder = run_folder(background=Background.WHITE)
    (folder / "report.html").write_text("<p><!-- gscore view --></p>")
    code, out, err = gscore("view", folder, "--photos", "3", "--json", "--quiet")
    assert code == 0, err
    reported = json.loads(out)
    path = folder / "view.html"
    assert reported["file"] == str(path) and reported["bytes"] == path.stat().st_size
    assert (
        reported["splats"] == len(splats) and reported["cameras"] == 9 and reported["photos"] == 3
    )
    assert reported["packing_psnr"] > 35 and reported["packing_difference"] < MOST
    browser.size(700, 300)
    browser.open(path)
    assert browser.value("viewer.scene.background") == [1, 1, 1]
    assert browser.value("document.querySelectorAll('option').length") == 9
    assert "held out" in browser.value("document.getElementById('cameras').innerText")
    assert browser.value("viewer.camera.photo.length") > 100  # the first view has one
    browser.key("p")
    browser.canvas()
    box = browser.value("document.querySelector('figure img').getBoundingClientRect().width")
    assert box == pytest.approx(350, abs=2) and abs(browser.canvas().shape[1] - 350) <= 2
    assert browser.value("document.querySelector('figure img').naturalWidth") == 48
    assert 'href="view.html"' in (folder / "report.html").read_text()
    assert gscore("view", folder, "--photos", "0", "--quiet")[0] == 0
    assert (folder / "report.html").read_text().count("<iframe") == 1
    assert path.stat().st_size < reported["bytes"]


def test_splats_alone_become_a_page(gscore, tmp_path, splats, browser):
    """Oracle: a PLY without cameras is seen from its front; the mark of antialiasing counts."""
    write_splats(tmp_path / "a.ply", splats, comments=(MIP_COMMENT,))
    code, out, err = gscore("view", tmp_path / "a.ply", "-o", tmp_path / "a.html")
    assert code == 0 and "no cameras" in err and "60 splats, 0 cameras" in " ".join(out.split())
    browser.size(400, 300)
    browser.open(tmp_path / "a.html")
    assert browser.value("viewer.scene.antialias") is True
    assert np.ptp(browser.canvas()) > 60
    assert browser.complaints() == []


@pytest.mark.parametrize(
    ("line", "up"),
    [("Vertical Axis: z", [0, 0, 1]), ("Vertical axis: y", [0, -1, 0]), ("gscore up Y", [0, 1, 0])],
)
def test_splats_alone_stand_upright(splats, tmp_path, line, up):
    """Oracle: the axis that the file states as up, which points to the top of the first picture."""
    write_splats(tmp_path / "a.ply", splats, comments=(line,))
    views = _without_cameras(open_model(tmp_path / "a.ply"), [])
    np.testing.assert_array_equal(views.up, up)
    right, down = views.first.viewmat[:2, :3]
    assert down @ up < -0.9 and abs(right @ up) < 1e-6
    at = views.first.viewmat @ [*views.focus, 1]
    assert at[2] > 0 and abs(at[:2]).max() < 1e-6


def test_page_reports_dropped_harmonics(gscore, tmp_path, splats):
    """Oracle: the sentence, which a model of degree 3 is not told."""
    for rest, reported in ((24, True), (15, False)):
        shN = np.zeros((len(splats), rest, 3), np.float32)
        write_splats(tmp_path / "a.ply", replace(splats, shN=shN))
        code, out, err = gscore(
            "view", tmp_path / "a.ply", "-o", tmp_path / f"{rest}.html", "--json"
        )
        assert code == 0 and json.loads(out)["sh_degree"] == 3
        assert ("supports SH degree 3" in " ".join(err.split())) == reported


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("-o a.txt", "ends in .html"),
        ("-o report.html", "report"),
        ("-o a.html --photos -1", "--photos must be at least 0"),
        ("", "give a page with -o"),
    ],
)
def test_unwritable_pages_are_refused(gscore, tmp_path, splats, monkeypatch, line, sentence):
    """Oracle: one sentence, exit code 2, nothing written."""
    monkeypatch.chdir(tmp_path)
    write_splats(tmp_path / "a.ply", splats)
    code, _, err = gscore("view", "a.ply", *line.split(), "--quiet")
    assert code == 2 and sentence in " ".join(err.split())
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]


def test_pages_of_others_stay(gscore, tmp_path, splats):
    """Oracle: the bytes of a user's file; gscore's own is replaced."""
    write_splats(tmp_path / "a.ply", splats)
    page = tmp_path / "a.html"
    page.write_text("<p>mine</p>")
    line = ("view", tmp_path / "a.ply", "-o", page, "--quiet")
    code, _, err = gscore(*line)
    assert code == 2 and "--overwrite" in err and page.read_text() == "<p>mine</p>"
    assert gscore(*line, "--overwrite")[0] == 0
    assert gscore(*line)[0] == 0

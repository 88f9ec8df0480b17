"""The graphics card's picture, in Blenders that offer one without a window (5.2 and later)."""

import bpy
import numpy as np
import pytest

from addon.cameras.render_camera import RenderCamera
from addon.core import Rendered, Splats, render, transform_splats
from addon.live import atlas, order
from tests.addon import splat_scenes as lab
from tests.addon.live import graphics
from tests.light_changes import decode

pytestmark = pytest.mark.graphics

SIZE = (160, 110)
LIMIT = 2 / 255


@pytest.fixture(scope="module")
def card():
    """The programs."""
    graphics.begin()
    from addon.live.card import Card

    made = Card()
    while not made.step():
        pass
    yield made


def view(orthographic: bool = False) -> RenderCamera:
    """A view 2 units in front of the origin, off centre."""
    viewmat = np.eye(4)
    viewmat[2, 3] = 2.0
    focal = 60.0 if orthographic else 140.0
    return RenderCamera(
        viewmat=viewmat,
        K=np.array([[focal, 0, 78], [0, 1.1 * focal, 52], [0, 0, 1.0]]),
        width=SIZE[0],
        height=SIZE[1],
        near=0.1,
        orthographic=orthographic,
        name="view",
    )


WINDOW = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1.002, -0.2002], [0, 0, -1, 0]])
"""Blender's projection with the near plane at 0.1 and the far one at 100."""


def drawn(card, parts: list[Splats], matrices, camera, **options):
    """[H, W, 4] premultiplied sRGB values, the top row first."""
    return painted(card, parts, matrices, camera, **options)[0]


def painted(
    card,
    parts,
    matrices,
    camera,
    *,
    meshes=None,
    limit=None,
    nearness=False,
    exact=False,
    first=0,
    **options,
):
    """The same, and [H, W] nearness or None."""
    from addon.live.card import Canvas, Shot
    from addon.live.clip import Cuts
    from addon.live.texture_upload import Order, Texels, texture

    viewmats = tuple(camera.viewmat @ m for m in matrices)
    made = atlas.build(parts)
    eye = order.Eye(viewmats=viewmats, orthographic=camera.orthographic)
    arranged = order.arrange(made, eye, len(made))
    arranged[:, 0] += first
    entries = Order(arranged)
    while not entries.step():
        pass
    texels = Texels(made.texels)
    while not texels.complete:
        texels.step(card.copy)
    target = Canvas(*SIZE, nearness=nearness, exact=exact)
    shot = Shot(
        camera=camera,
        viewmats=viewmats,
        window=options.get("window", WINDOW),
        antialias=options.get("antialias", False),
        limit=first + len(made) if limit is None else limit,
        cuts=options.get("cuts", Cuts()),
    )
    depths = None if meshes is None else texture(meshes[::-1, :, None])
    card.draw(target, texels.texture, entries, shot, depths)
    near = None if target.nearness is None else values(target.nearness, 1)[..., 0]
    return values(target.picture, 4), near


def values(texture, channels: int) -> np.ndarray:
    """[H, W, C] float32 of a texture of the picture's size, the top row first."""
    found = texture.read()
    found.dimensions = SIZE[0] * SIZE[1] * channels
    return np.array(found, np.float32).reshape(SIZE[1], SIZE[0], channels)[::-1]


def truth(splats: Splats, camera: RenderCamera, **options) -> Rendered:
    """The picture by gscore.render."""
    given = {"near": camera.near, "orthographic": camera.orthographic, **options}
    return render(splats, camera.K, camera.viewmat, *SIZE, **given)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("antialias", [False, True])
def test_the_picture_is_that_of_f12(card, orthographic, antialias):
    """Oracle: gscore.render, to two levels of 8 bit."""
    splats, camera = lab.blob(2000), view(orthographic)
    got = drawn(card, [splats], [np.eye(4)], camera, antialias=antialias)
    want = truth(splats, camera, antialias=antialias)
    assert np.abs(got[..., :3] - want.rgb).max() < LIMIT
    assert np.abs(got[..., 3] - want.alpha).max() < LIMIT
    assert want.alpha.mean() > 0.2 and np.std(want.rgb) > 0.1


@pytest.mark.parametrize("splats", [lab.veil(3000), lab.blob(20_000)], ids=["veil", "blob"])
def test_the_picture_at_rest_has_all_digits(card, splats):
    """Oracle: gscore.render, to three hundredths of a level of 8 bit on the mean: hundreds of faint
    splats add up. Single pixels differ by a splat of the least opacity that is drawn."""
    apart = 255 * np.abs(
        drawn(card, [splats], [np.eye(4)], view(), exact=True)[..., :3] - truth(splats, view()).rgb
    )
    assert apart.mean() < 0.03 and np.quantile(apart, 0.99) < 0.3 and apart.max() < 1.8


def test_needles_and_sheets(card):
    """Oracle: gscore.render; axes that differ a thousandfold, as trained splats have them."""
    splats = lab.blob(1500)
    scales = splats.scales.copy()
    scales[::2, 0] += 2
    scales[1::2, 2] -= 5
    names = ("means", "quats", "opacities", "sh0", "shN")
    splats = Splats(**{n: getattr(splats, n) for n in names}, scales=scales)
    got, want = drawn(card, [splats], [np.eye(4)], view()), truth(splats, view())
    assert np.abs(got[..., :3] - want.rgb).max() < LIMIT


def test_several_objects_in_one_order(card):
    """Oracle: gscore.render of all splats transformed to one space."""
    parts = [lab.blob(700, seed=1), lab.blob(900, seed=2)]
    matrices = [np.eye(4), np.diag([0.5, 0.5, 0.5, 1.0])]
    matrices[1][:3, :3] = 0.5 * np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    matrices[1][:3, 3] = 0.3, -0.1, -0.2
    moved = [transform_splats(p, m) for p, m in zip(parts, matrices, strict=True)]
    names = ("means", "quats", "scales", "opacities", "sh0", "shN")
    both = Splats(**{n: np.concatenate([getattr(p, n) for p in moved]) for n in names})
    got, want = drawn(card, parts, matrices, view()), truth(both, view())
    assert np.abs(got[..., :3] - want.rgb).max() < LIMIT


def test_meshes_hide_what_is_behind_them(card):
    """Oracle: gscore.render of the splats in front of the mesh at its pixels; of all, elsewhere."""
    splats, camera = lab.blob(2000), view()
    z = 2.0
    depth = 0.5 + 0.5 * (-WINDOW[2, 2] * z + WINDOW[2, 3]) / z
    meshes = np.ones((SIZE[1], SIZE[0]), np.float32)
    meshes[:, :70] = depth
    got = drawn(card, [splats], [np.eye(4)], camera, meshes=meshes)
    front = truth(splats.subset(splats.means[:, 2] + 2 <= z), camera)
    everything = truth(splats, camera)
    assert np.abs(got[:, :70, :3] - front.rgb[:, :70]).max() < LIMIT
    assert np.abs(got[:, 70:, :3] - everything.rgb[:, 70:]).max() < LIMIT
    assert np.abs(front.rgb - everything.rgb)[:, :70].max() > 0.2


def test_depths_are_blended_like_colours(card):
    """Oracle: gscore.render of splats with the colour 1 - depth."""
    splats, camera = lab.blob(2000), view()
    z = splats.means[:, 2].astype(np.float64) + 2
    place = 0.5 + 0.5 * (-WINDOW[2, 2] * z + WINDOW[2, 3]) / z
    gray = np.repeat(((1 - place) - 0.5)[:, None, None] / 0.28209479177387814, 3, axis=2)
    names = ("means", "quats", "scales", "opacities")
    given = {n: getattr(splats, n) for n in names}
    shaded = Splats(**given, sh0=gray.astype(np.float32), shN=np.zeros_like(splats.shN))
    picture, near = painted(card, [splats], [np.eye(4)], camera, nearness=True)
    want = truth(shaded, camera).rgb[..., 0]
    assert np.abs(near - want).max() < 2e-3 * want.max()
    assert np.array_equal(picture, drawn(card, [splats], [np.eye(4)], camera))
    assert np.ptp((1 - place)[np.abs(place) < 1]) > 0.02


@pytest.mark.parametrize("orthographic", [False, True])
def test_splats_outside_clip_planes_are_omitted(card, orthographic):
    """Oracle: gscore.render of the splats on the planes' inner sides; an object that is moved."""
    from addon.live.clip import Cuts

    splats, camera, matrix = lab.blob(2000), view(orthographic), np.diag([0.8, 0.8, 0.8, 1.0])
    matrix[:3, 3] = 0.1, -0.05, 0.1
    moved = transform_splats(splats, matrix)
    planes = np.array([[1.0, 0, 0, 0.02], [0, -0.6, 0.8, 0.05], [0, 0, 0, 0]])
    cut = (moved.means @ planes[:, :3].T + planes[:, 3] >= 0).all(axis=1)
    assert 300 < cut.sum() < 1700
    got = drawn(card, [splats], [matrix], camera, cuts=Cuts(planes=planes))
    want = truth(moved.subset(cut), camera)
    assert np.abs(got[..., :3] - want.rgb).max() < LIMIT
    assert np.abs(truth(moved, camera).rgb - want.rgb).max() > 0.2


def test_splats_beyond_the_far_plane_are_omitted(card):
    """Oracle: gscore.render of the splats in front of it; of all, if the view has none."""
    from addon.live.clip import Cuts

    splats, camera = lab.blob(2000), view()
    window, far = WINDOW.copy(), 2.1
    window[2, 2:] = -(far + 0.1) / (far - 0.1), -2 * far * 0.1 / (far - 0.1)
    before = splats.subset(splats.means[:, 2] + 2 <= far)
    for cuts, seen in ((Cuts(far=True), before), (Cuts(), splats)):
        got = drawn(card, [splats], [np.eye(4)], camera, cuts=cuts, window=window)
        assert np.abs(got[..., :3] - truth(seen, camera).rgb).max() < LIMIT
    assert 300 < len(before) < 1700


def test_fewer_splats(card):
    """Oracle: gscore.render of the first rows of the atlas."""
    splats = lab.blob(2000)
    first = atlas.build([splats]).index[:300]
    chosen = np.zeros(2000, bool)
    chosen[first] = True
    got = drawn(card, [splats], [np.eye(4)], view(), limit=300)
    assert np.abs(got[..., :3] - truth(splats.subset(chosen), view()).rgb).max() < LIMIT


@pytest.mark.parametrize("first", [1 << 23, (1 << 24) - 2048])
def test_rows_beyond_half_of_what_float32_counts(card, monkeypatch, first):
    """Oracle: the picture of the same splats in the first rows, to the bit. The program is changed
    to read those rows, up to the last one of an atlas, from the beginning of a small one."""
    from addon.live import program

    splats = lab.blob(2048)
    want = drawn(card, [splats], [np.eye(4)], view())
    place = "row / COLUMNS)"
    assert program._SPLAT_VERTEX.count(place) == 1 and first % atlas.COLUMNS == 0
    moved = program._SPLAT_VERTEX.replace(place, f"row / COLUMNS - {first // atlas.COLUMNS})")
    monkeypatch.setattr(program, "_SPLAT_VERTEX", moved)
    monkeypatch.setattr(card, "_splats", program.splats())
    np.testing.assert_array_equal(drawn(card, [splats], [np.eye(4)], view(), first=first), want)
    assert first + len(splats) <= atlas.MOST and np.std(want) > 0.1


def test_an_atlas_comes_in_pieces(card, monkeypatch):
    """Oracle: the texels themselves, to the bit; in chunks of one row, and of five, which leaves
    three."""
    from addon.live.texture_upload import Texels

    values = np.random.default_rng(0).normal(0, 1e6, (13, 40, 3, 4)).astype(np.float32)
    values[3, 5, 1] = 1e-38, -0.0, 16777215.0, 3e38
    for piece, steps in ((1, 13), (5 * 120, 3)):
        monkeypatch.setattr(Texels, "PIECE", piece)
        texels = Texels(values)
        for _ in range(steps):
            assert not texels.complete
            texels.step(card.copy)
        assert texels.complete
        found = texels.texture.read()
        found.dimensions = values.size
        np.testing.assert_array_equal(np.array(found, np.float32), values.reshape(-1))


def test_chunks_that_stay_are_not_uploaded_again(card, monkeypatch):
    """Oracle: the textures themselves, and the picture of an order that is uploaded whole."""
    from addon.live.texture_upload import Order

    monkeypatch.setattr(Order, "CHUNK", 500)
    entries = np.random.default_rng(0).uniform(0, 1, (1300, 4)).astype(np.float32)
    first = Order(entries)
    while not first.step():
        pass
    changed = entries.copy()
    changed[700, 1] = 9
    second = Order(changed, first)
    while not second.step():
        pass
    kept = [a[0] is b[0] for a, b in zip(first.chunks, second.chunks, strict=True)]
    assert kept == [True, False, True] and [n for _, n in second.chunks] == [500, 500, 300]
    shorter = Order(changed[:1200], second)
    while not shorter.step():
        pass
    assert [n for _, n in shorter.chunks] == [500, 500, 200]
    assert shorter.chunks[2][0] is not second.chunks[2][0]


def test_without_a_window_nothing_is_registered(scene):
    """Oracle: the display of new objects, and the message of the panel."""
    from addon.splats.live_display import SESSION

    if not bpy.app.background:
        pytest.skip("there is a window")
    assert not SESSION.works and not SESSION.problem
    assert lab.add(scene, lab.blob()).gscore.display == "POINTS"


@pytest.fixture
def laid(card):
    """Draw splats over a grey target, with or without the view's own target; return both, [H, W,
    4], and the picture."""
    import gpu

    from addon.live.card import Canvas

    def lay(scene_of=lambda target: target, window=None):
        splats, camera = lab.blob(2000), view()
        rgba = drawn(card, [splats], [np.eye(4)], camera, exact=True)
        canvas = Canvas(*SIZE, nearness=False, exact=True)
        data = gpu.types.Buffer("FLOAT", rgba.size, np.ascontiguousarray(rgba[::-1]).reshape(-1))
        canvas.picture = gpu.types.GPUTexture(SIZE, format="RGBA32F", data=data)
        found = []
        for _ in range(2):
            made = gpu.types.GPUTexture(SIZE, format="RGBA32F")
            found.append((made, gpu.types.GPUFrameBuffer(color_slots=made)))
        (over, over_target), (within, within_target) = found
        for target in (over_target, within_target):
            with target.bind():
                target.clear(color=(0.5, 0.5, 0.5, 0.25))
        with over_target.bind():
            card.show(canvas, (0, 0, *SIZE), None, scene_of(within_target), window)
        return values(over, 4), values(within, 4), rgba

    yield lay
    card._shut = False


def test_a_picture_lies_within_a_view(laid):
    """Oracle: IEC 61966-2-1 and the formulas of blending; covered overlays are fainter
    accordingly."""
    over, within, rgba = laid()
    alpha = rgba[..., 3:]
    straight = np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 0)
    straight = np.clip(straight, 0, 1)
    light = decode(straight)
    grey = np.array([0.5, 0.5, 0.5, 0.25])
    np.testing.assert_allclose(over, grey * (1 - alpha), atol=1e-5)
    want = np.concatenate([light, np.ones_like(alpha)], axis=2) * alpha + grey * (1 - alpha)
    np.testing.assert_allclose(within, want, atol=1e-4)
    assert alpha.mean() > 0.2


@pytest.mark.parametrize("within", [False, True])
def test_a_region_of_a_view_alone_is_drawn(laid, within):
    """Oracle: the whole picture inside the region, to the bit; the earlier picture outside."""
    scene_of = (lambda target: target) if within else (lambda target: None)
    left, top, width, height = window = 20, 10, 90, 70
    part = np.s_[top : top + height, left : left + width]
    for got, whole in zip(laid(scene_of, window)[:2], laid(scene_of)[:2], strict=True):
        np.testing.assert_array_equal(got[part], whole[part])
        beside = np.ones(SIZE[::-1], bool)
        beside[part] = False
        assert (got[beside] == (0.5, 0.5, 0.5, 0.25)).all()
    assert (whole[beside] != got[beside]).any() == within


@pytest.mark.parametrize("nearness", [False, True])
def test_the_part_that_is_drawn_to_stays(card, nearness):
    """Oracle: the viewport and the scissor of the target before each call."""
    import gpu

    from addon.live.card import Canvas
    from addon.live.texture_upload import Texels

    outer, scene = (gpu.types.GPUOffScreen(*SIZE, format="RGBA32F") for _ in range(2))
    canvas = Canvas(*SIZE, nearness=nearness)
    part, scissor = (20, 30, 90, 60), (25, 35, 40, 20)
    texels = Texels(atlas.build([lab.blob(2000)]).texels)
    with outer.bind():
        for call in (
            lambda: painted(card, [lab.blob(20)], [np.eye(4)], view(), nearness=nearness),
            lambda: texels.step(card.copy),
            lambda: card.show(canvas, part, None, scene),
            lambda: card.show(canvas, part, None, scene, (5, 5, 9, 9)),
        ):
            gpu.state.viewport_set(*part)
            gpu.state.scissor_set(*scissor)
            call()
            assert (gpu.state.viewport_get(), gpu.state.scissor_get()) == (part, scissor)
        gpu.state.viewport_set(0, 0, *SIZE)
        gpu.state.scissor_set(0, 0, *SIZE)


def test_a_view_that_cannot_be_drawn_to_is_drawn_over(laid, card, caplog):
    """Oracle: the picture drawn over the view without its own target; logged once."""

    class Gone:
        """A fake of a target whose memory Blender has freed."""

        def bind(self):
            raise ReferenceError("GPU framebuffer no longer valid")

    want, untouched, _ = laid(lambda target: None)
    for _ in range(2):
        over, within, _ = laid(lambda target: Gone())
        np.testing.assert_array_equal(over, want)
        np.testing.assert_array_equal(within, untouched)
    assert card._shut and len(caplog.records) == 1

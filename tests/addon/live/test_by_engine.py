"""Pictures of views whose splats the graphics card cannot draw. Oracles are named in the tests."""

import time
from dataclasses import replace

import bpy
import numpy as np
import pytest

from addon.compat import TEXTURES_ARE_ENCODED
from addon.core import CancelFlag, Splats, render
from addon.live.clip import Cuts, z_of
from addon.live.engine_pictures import EngineRequest
from addon.render.color import EXPONENT, over_view
from addon.render.marks import SHARE, TINT
from addon.render.mesh_copies import HIDDEN, SELECTED, freeze
from addon.render.model import SplatCache
from addon.render.scene import place, sources
from addon.render.selections import Tinted
from addon.render.viewport import ViewPainter, smaller, view_camera
from tests.addon import splat_scenes as lab

SIZE = (96, 64)
PERSPECTIVE = np.array(
    [[1.6, 0, 0, 0], [0, 2.4, 0, 0], [0, 0, -1.002002, -0.2002002], [0, 0, -1, 0]]
)
"""Near plane at 0.1, far one at 100."""
PARALLEL = np.array([[0.6, 0, 0, 0], [0, 0.9, 0, 0], [0, 0, -0.1, 0], [0, 0, 0, 1.0]])
"""From 10 behind to 10 ahead."""
VIEW = np.eye(4)
VIEW[2, 3] = -2.0
"""2 above the origin, looking down."""


@pytest.fixture
def wish(scene: bpy.types.Scene) -> tuple[EngineRequest, Splats]:
    """A request for the picture of a blob in a perspective view, and the blob's splats."""
    ob = lab.add(scene, lab.blob(1500))
    bpy.context.view_layer.update()
    (source,) = sources(bpy.context.evaluated_depsgraph_get())
    frozen = freeze(ob.data, ob.name)
    made = EngineRequest(
        placed=[place(source, frozen)],
        camera=view_camera(VIEW, PERSPECTIVE, *SIZE, perspective=True),
        window=PERSPECTIVE,
        antialias="AUTO",
        depths=None,
        cuts=Cuts(),
        tinted=Tinted.ALL,
    )
    return made, frozen.read()


def parallel(wish: EngineRequest) -> EngineRequest:
    """The same with parallel rays."""
    camera = view_camera(VIEW, PARALLEL, *SIZE, perspective=False)
    return replace(wish, camera=camera, window=PARALLEL)


def drawn(wish: EngineRequest, camera=None) -> np.ndarray:
    """[H, W, 4], the bottom row first."""
    model = SplatCache().model(wish.placed)
    return wish.shoot(model, camera or wish.camera, lambda: False, CancelFlag())


def truth(wish: EngineRequest, splats: Splats, **options) -> np.ndarray:
    """The same as rendered by gscore."""
    camera = wish.camera
    given = {"near": camera.near, "orthographic": camera.orthographic, **options}
    found = render(splats, camera.K, camera.viewmat, *SIZE, **given)
    return over_view(found.rgb, found.alpha)


def test_what_lies_over_a_view_shows_its_colours():
    """Oracle: Blender's processing of overlays, by IEC 61966-2-1 and its exponent."""
    rgb = np.float32([[[0.4, 0.2, 0.1], [0.0, 0.0, 0.0]]])
    alpha = np.float32([[0.5, 0.0]])
    held = over_view(rgb, alpha)
    decoded = np.where(held <= 0.04045, held / 12.92, ((held + 0.055) / 1.055) ** 2.4)
    light = decoded if TEXTURES_ARE_ENCODED else held
    behind = 0.3**EXPONENT
    mixed = (light[..., :3] + behind * (1 - alpha[..., None])) ** (1 / EXPONENT)
    want = (0.5 * np.array([0.8, 0.4, 0.2]) ** EXPONENT + 0.5 * behind) ** (1 / EXPONENT)
    np.testing.assert_allclose(mixed[0, 0], want, atol=1e-5)
    np.testing.assert_allclose(mixed[0, 1], 0.3, atol=1e-5)


@pytest.mark.parametrize("orthographic", [False, True])
def test_meshes_hide_what_is_behind_them(wish, orthographic):
    """Oracle: gscore.render of the splats in front of the mesh at its pixels; of all, elsewhere."""
    asked, splats = wish
    asked = parallel(asked) if orthographic else asked
    z = splats.means @ asked.camera.viewmat[2, :3] + asked.camera.viewmat[2, 3]
    middle = float(np.median(z))
    depths = np.ones(SIZE[::-1], np.float32)
    factor, offset = asked.window[2, 2], asked.window[2, 3]
    own = middle if not orthographic else middle - (asked.camera.viewmat[2, 3] - 2.0)
    depths[:, :40] = 0.5 + 0.5 * (
        offset - factor * own if orthographic else (offset - factor * own) / own
    )
    np.testing.assert_allclose(z_of(depths[0, 0], asked.camera, asked.window), middle, rtol=1e-4)
    got = drawn(replace(asked, depths=depths))
    before = truth(asked, splats.subset(z <= middle))
    every = truth(asked, splats)
    assert np.abs(got[:, :40] - before[:, :40]).max() < 0.03
    assert np.abs(got[:, 40:] - every[:, 40:]).max() < 1e-6
    assert np.abs(before - every)[:, :40].max() > 0.2


@pytest.mark.parametrize("orthographic", [False, True])
def test_what_is_cut_off_is_gone(wish, orthographic):
    """Oracle: gscore.render of the remaining splats."""
    asked, splats = wish
    asked = parallel(asked) if orthographic else asked
    cuts = Cuts(far=True, planes=np.array([[1.0, 0, 0, 0.1], [0, -1.0, 0, 0.2]]))
    there = (splats.means[:, 0] >= -0.1) & (splats.means[:, 1] <= 0.2)
    got, want = drawn(replace(asked, cuts=cuts)), truth(asked, splats.subset(there))
    assert np.abs(got - want).max() < 1e-6 and 0.1 < there.mean() < 0.9
    near = PERSPECTIVE.copy()
    near[2, 2:] = -(2.0 + 0.1) / (2.0 - 0.1), -2 * 2.0 * 0.1 / (2.0 - 0.1)  # ends 2 away
    if not orthographic:
        camera = view_camera(VIEW, near, *SIZE, perspective=True)
        asked = replace(asked, window=near, camera=camera, cuts=Cuts(far=True))
        want = truth(asked, splats.subset(splats.means[:, 2] >= 0))
        assert np.abs(drawn(asked) - want).max() < 1e-6


def test_what_is_selected_and_hidden_is_seen(wish):
    """Oracle: gscore.render of splats whose colour is mixed with the tint, without hidden ones."""
    asked, splats = wish
    marks = np.zeros(1500, np.uint8)
    marks[:500], marks[500:800] = SELECTED, HIDDEN
    own = asked.placed[0]
    placed = [replace(own, frozen=own.frozen.remarked(marks), edited=True)]
    got = drawn(replace(asked, placed=placed))
    sh0, shN = splats.sh0.copy(), splats.shN.copy()
    sh0[:500] = (1 - SHARE) * sh0[:500] + SHARE * (TINT - 0.5) / 0.28209479
    shN[:500] = (1 - SHARE) * shN[:500]
    tinted = replace(splats, sh0=sh0, shN=shN).subset(marks != HIDDEN)
    want = truth(asked, tinted)
    assert np.abs(got - want).max() < 1e-5
    assert np.abs(truth(asked, splats) - want).max() > 0.2


def test_a_smaller_picture_is_of_the_same_view(wish):
    """Oracle: means of the pixels of the full picture, including depths."""
    asked, _ = wish
    depths = np.ones(SIZE[::-1], np.float32)
    depths[:32, 48:] = 0  # the lower right
    asked = replace(asked, depths=depths)
    small = drawn(asked, smaller(asked.camera, 2))[..., 3]
    full = drawn(asked)[..., 3].reshape(32, 2, 48, 2).mean((1, 3))
    assert not small[:16, 24:].any() and np.abs(small - full).mean() < 0.02 < full.mean()


def test_a_painter_draws_it_once(wish):
    """Oracle: the same picture without a thread; an equal request is ignored."""
    asked, _ = wish
    painter = ViewPainter(SplatCache())
    painter.ask(asked)
    until = time.monotonic() + 60
    while not painter.shows(asked) and time.monotonic() < until:
        time.sleep(0.01)
    assert np.array_equal(painter.pixels, drawn(asked))
    pixels = painter.pixels
    painter.ask(replace(asked, placed=list(asked.placed)))
    assert not painter.busy and painter.pixels is pixels
    others = [
        replace(asked, cuts=Cuts(far=True)),
        replace(asked, depths=np.ones(SIZE[::-1], np.float32)),
        replace(asked, tinted=Tinted.NONE),
        replace(asked, placed=[replace(asked.placed[0], edited=True)]),
        parallel(asked),
    ]
    assert not any(asked.same(other) for other in [None, *others])
    painter.close()

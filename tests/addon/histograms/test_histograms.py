"""Histograms of splats. Oracle: numpy's counts, and the filters that hide splats."""

import bpy
import numpy as np
import pytest

from addon import attributes
from addon.histograms import counted, icons
from addon.histograms.counting import OPACITY, SIZE, of_opacities, of_sizes
from addon.panels.result import FiltersPanel
from tests.addon import points
from tests.addon import splat_scenes as lab
from tests.addon.drawn import drawn


def heights(pixels: np.ndarray, shown: bool) -> np.ndarray:
    """How high the bars stand in each column, of those that are shown or hidden."""
    blue = pixels[..., 2] > 1.5 * pixels[..., 0]
    return ((pixels[..., 3] > 0.3) & (blue == shown)).sum(0)


def test_bars_go_with_the_counts():
    """Oracle: a ramp of counts; the square root of each, of the picture's height."""
    values = np.repeat((np.arange(96) + 0.5) / 96, np.arange(96) + 1)
    found = of_opacities(values)
    np.testing.assert_array_equal(found.counts, np.arange(96) + 1)
    bars = heights(found.picture(96, 100, 0.0, 0.0), shown=True)
    np.testing.assert_allclose(bars, 100 * np.sqrt((np.arange(96) + 1) / 96), atol=1)


@pytest.mark.parametrize(("smallest", "largest"), [(0.0, 0.0), (0.02, 0.0), (0.01, 0.1)])
def test_what_the_limits_hide_is_grey(smallest, largest):
    """Oracle: the share of the splats that the filters' own mask keeps."""
    sizes = np.exp(np.random.default_rng(0).uniform(np.log(0.001), 0, 100_000))
    found = of_sizes(sizes)
    assert found.counts.sum() == len(sizes)
    pixels = found.picture(192, 64, smallest, largest)
    shown, hidden = heights(pixels, True) > 0, heights(pixels, False) > 0
    kept = (sizes >= smallest) & ((sizes <= largest) if largest else True)
    assert shown.sum() / 192 == pytest.approx(kept.mean(), abs=0.02)
    assert (shown | hidden).all() and not (shown & hidden).any()


def test_odd_splats_have_histograms_too():
    """Oracle: counts, of none, of one, and of splats all alike."""
    for sizes in ([], [0.1], [0.1] * 5, [0.0, 0.1]):
        found = of_sizes(np.array(sizes, np.float32))
        assert found.counts.sum() == len(sizes)
        assert np.isfinite(found.picture(20, 20, 0.05, 0.2)).all()


def test_a_place_stands_for_a_value():
    """Oracle: the way back, on an even axis and on a logarithmic one."""
    for found in (of_opacities(np.array([0.5])), of_sizes(np.geomspace(0.001, 10, 100))):
        for place in (0.0, 0.3, 1.0):
            assert found.place(found.value(place)) == pytest.approx(place, abs=1e-6)


def test_meshes_are_counted_when_they_have_changed(scene):
    """Oracle: the number of readings, and numpy's counts after an edit."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    bpy.context.view_layer.update()
    of = counted.COUNTED.of
    first = of(ob)[OPACITY]
    assert first.counts.sum() == 400
    assert of(ob)[OPACITY] is first
    points.keep(ob.data, np.arange(400) < 150)
    ob.data.update()
    bpy.context.view_layer.update()
    opacities = attributes.column(ob.data, attributes.BASE)[:, 3]
    counts = of(ob)[OPACITY].counts
    np.testing.assert_array_equal(counts, np.histogram(opacities, 96, (0, 1))[0])
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")
    counted.COUNTED.forget({ob.data.session_uid})
    assert of(ob)[OPACITY].counts is counts  # those of before
    counted.COUNTED.clear()
    assert of(ob) == {}
    bpy.ops.object.mode_set(mode="OBJECT")


def test_many_are_counted_beside_blender(scene, monkeypatch):
    """Oracle: numpy's counts; nothing is there until the beat has done all pieces, and a mesh that
    goes meanwhile leaves nothing."""
    lab.prepare(scene)
    monkeypatch.setattr(counted, "MOST", 100)
    ob = lab.add(scene, lab.blob())
    of = counted.COUNTED.of
    assert of(ob) == {} and counted.COUNTED.waits()
    while counted.COUNTED.waits():
        assert of(ob) == {}
        counted.COUNTED.collect()
    sizes = attributes.column(ob.data, attributes.SCALE)[::4].max(axis=1)
    np.testing.assert_array_equal(of(ob)[SIZE].counts, of_sizes(sizes).counts)
    other = lab.add(scene, lab.blob())
    assert of(other) == {}
    mesh = other.data
    bpy.data.objects.remove(other)
    bpy.data.meshes.remove(mesh)
    while counted.COUNTED.waits():
        counted.COUNTED.collect()
    assert of(ob) == {}  # is asked for anew
    counted.COUNTED.clear()


def test_the_panel_shows_two_with_their_sliders(scene, monkeypatch):
    """Oracle: the order of what the panel puts down, with icons as a window has them."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    bpy.context.view_layer.objects.active = ob
    assert drawn(FiltersPanel).startswith("<opacity_min>")  # icons have no number here
    monkeypatch.setattr(icons.ICONS, "update", lambda ob, kind: 7)
    wanted = "By opacity [picture] By size [picture] <opacity_min> <size_min> <size_max>"
    assert drawn(FiltersPanel).startswith(wanted)


def test_icons_follow_the_filters(scene):
    """Oracle: the picture that the counts give for the limits."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    for limit in (0.0, 0.5):
        ob.gscore.opacity_min = limit
        icons.ICONS.update(ob, OPACITY)
        wanted = counted.COUNTED.of(ob)[OPACITY].picture(192, 192, limit, 0.0)
        got = np.array(icons.ICONS._icons[OPACITY].image_pixels_float[:]).reshape(192, 192, 4)
        np.testing.assert_allclose(got, wanted, atol=1 / 255)


def test_splats_without_sizes_have_no_histograms(scene):
    """Oracle: what the panel puts down, of a missing attribute and of a number that is none."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    bpy.context.view_layer.objects.active = ob
    ob.data.attributes[attributes.SCALE].data[7].vector.x = np.nan
    assert counted.COUNTED.of(ob) == {}
    ob.data.attributes.remove(ob.data.attributes[attributes.SCALE])
    counted.COUNTED.forget({ob.data.session_uid})
    assert counted.COUNTED.of(ob) == {}
    assert drawn(FiltersPanel).startswith("<opacity_min>")

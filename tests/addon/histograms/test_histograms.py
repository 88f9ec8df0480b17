"""Histograms of splats. Oracle: numpy's counts, and the filters that hide splats."""

import time
from collections.abc import Iterator

import bpy
import numpy as np
import pytest

from addon import attributes
from addon.histograms import histogram_cache
from addon.histograms.counting import OPACITY, SIZE, of_opacities, of_sizes
from addon.panels.result import FiltersPanel
from tests.addon import points
from tests.addon import splat_scenes as lab
from tests.addon.drawn import drawn


def heights(pixels: np.ndarray, shown: bool) -> np.ndarray:
    """Heights of the bars in each column, of visible or hidden splats."""
    blue = pixels[..., 2] > 1.5 * pixels[..., 0]
    return ((pixels[..., 3] > 0.3) & (blue == shown)).sum(0)


def test_bars_go_with_the_counts():
    """Oracle: a ramp of counts; the square root of each, times the picture's height."""
    values = np.repeat((np.arange(96) + 0.5) / 96, np.arange(96) + 1)
    found = of_opacities(values)
    np.testing.assert_array_equal(found.counts, np.arange(96) + 1)
    bars = heights(found.picture(96, 100, 0.0, 0.0), shown=True)
    np.testing.assert_allclose(bars, 100 * np.sqrt((np.arange(96) + 1) / 96), atol=1)


@pytest.mark.parametrize(("smallest", "largest"), [(0.0, 0.0), (0.02, 0.0), (0.01, 0.1)])
def test_filtered_part_is_grey(smallest, largest):
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
    """Oracle: counts, of none, of one, and of equal splats."""
    for sizes in ([], [0.1], [0.1] * 5, [0.0, 0.1]):
        found = of_sizes(np.array(sizes, np.float32))
        assert found.counts.sum() == len(sizes)
        assert np.isfinite(found.picture(20, 20, 0.05, 0.2)).all()


def test_a_place_stands_for_a_value():
    """Oracle: the inverse, on a linear axis and on a logarithmic one."""
    for found in (of_opacities(np.array([0.5])), of_sizes(np.geomspace(0.001, 10, 100))):
        for place in (0.0, 0.3, 1.0):
            assert found.place(found.value(place)) == pytest.approx(place, abs=1e-6)


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch) -> Iterator[histogram_cache.HistogramCache]:
    """A `HistogramCache` without the wait for unchanged meshes."""
    monkeypatch.setattr(histogram_cache, "QUIET", 0.0)
    yield histogram_cache.HISTOGRAMS
    histogram_cache.HISTOGRAMS.clear()


def wait_for_counts(kept: histogram_cache.HistogramCache) -> int:
    """Poll until all is counted; return the number of polls with new results."""
    new = 0
    while kept.waits():
        new += kept.collect()
    return new


def changed(ob: bpy.types.Object) -> None:
    """Report changed values to Blender."""
    ob.data.update()
    bpy.context.view_layer.update()


def numbers(kept: histogram_cache.HistogramCache, ob: bpy.types.Object) -> list[int]:
    """Number of splats of each histogram."""
    return [int(found.counts.sum()) for found in kept.of(ob).values()]


def test_meshes_are_counted_when_they_have_changed(scene, kept):
    """Oracle: numpy's counts after an edit; the earlier ones until then, and in Edit Mode."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    bpy.context.view_layer.update()
    first = kept.of(ob)[OPACITY]
    assert first.counts.sum() == 400
    assert kept.of(ob)[OPACITY] is first and not kept.waits()
    points.keep(ob.data, np.arange(400) < 150)
    changed(ob)
    assert kept.of(ob)[OPACITY] is first
    assert wait_for_counts(kept) == 1
    opacities = attributes.column(ob.data, attributes.BASE)[:, 3]
    counts = kept.of(ob)[OPACITY].counts
    np.testing.assert_array_equal(counts, np.histogram(opacities, 96, (0, 1))[0])
    bpy.context.view_layer.objects.active = ob
    bpy.ops.object.mode_set(mode="EDIT")
    kept.forget({ob.data.session_uid})
    assert kept.of(ob)[OPACITY].counts is counts
    kept.clear()
    assert kept.of(ob) == {}
    bpy.ops.object.mode_set(mode="OBJECT")


def test_a_limit_makes_no_new_histogram(scene, kept, monkeypatch):
    """Oracle: the same histogram object after Blender has reported the mesh as changed; nothing is
    counted before the mesh rests."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    bpy.context.view_layer.update()
    first = kept.of(ob)[SIZE]
    ob.gscore.opacity_min = 0.3
    changed(ob)
    monkeypatch.setattr(histogram_cache, "QUIET", 60.0)
    assert kept.of(ob)[SIZE] is first and kept.waits()
    for _ in range(5):
        assert not kept.collect()
    assert not any(entry.task for entry in kept._entries.values())
    monkeypatch.setattr(histogram_cache, "QUIET", 0.0)
    assert wait_for_counts(kept) == 0
    assert kept.of(ob)[SIZE] is first


def test_many_are_counted_beside_blender(scene, kept, monkeypatch):
    """Oracle: numpy's counts of every fourth; no result until the poll timer has run all steps;
    with another mesh of the object, the earlier histograms stay until it is counted."""
    lab.prepare(scene)
    monkeypatch.setattr(histogram_cache, "MOST", 100)
    ob = lab.add(scene, lab.blob())
    assert kept.of(ob) == {} and wait_for_counts(kept) == 1
    sizes = attributes.column(ob.data, attributes.SCALE)[::4].max(axis=1)
    first = kept.of(ob)[SIZE]
    np.testing.assert_array_equal(first.counts, of_sizes(sizes).counts)
    ob.data = lab.add(scene, lab.blob(800)).data
    assert kept.of(ob)[SIZE] is first and wait_for_counts(kept) == 1
    assert numbers(kept, ob) == [100, 100]


def test_objects_of_two_windows_are_known_at_once(scene, kept, monkeypatch):
    """Oracle: both are counted in the end, although their requests alternate."""
    lab.prepare(scene)
    monkeypatch.setattr(histogram_cache, "MOST", 100)
    both = [lab.add(scene, lab.blob()), lab.add(scene, lab.blob(300))]
    for _ in range(50):
        for ob in both:
            kept.of(ob)
        kept.collect()
        time.sleep(0.01)
    assert [numbers(kept, ob) for ob in both] == [[100, 100], [100, 100]]
    assert not kept.waits()


def test_without_splats_there_is_no_histogram(scene, kept):
    """Oracle: an object whose splats were all deleted, or whose mesh is removed while it is
    counted."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    assert numbers(kept, ob) == [400, 400]
    ob.data.clear_geometry()
    changed(ob)
    assert kept.of(ob) == {}
    ob.data = lab.add(scene, lab.blob()).data
    kept.of(ob)
    mesh = ob.data
    bpy.data.objects.remove(ob)
    bpy.data.meshes.remove(mesh)
    wait_for_counts(kept)


def test_a_count_that_fails_leaves_what_was_there(scene, kept, monkeypatch):
    """Oracle: the earlier histogram, after an error in the thread that the poll timer reports."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    first = kept.of(ob)[SIZE]

    def fail(*given: object) -> None:
        raise MemoryError("no more")

    monkeypatch.setattr(histogram_cache, "_count", fail)
    kept.forget({ob.data.session_uid})
    kept.of(ob)
    with pytest.raises(MemoryError):
        wait_for_counts(kept)
    assert kept.of(ob)[SIZE] is first and not kept.waits()


def test_the_panel_shows_two_with_their_sliders(scene, monkeypatch):
    """Oracle: the order in the panel, with icons as in a window."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    bpy.context.view_layer.objects.active = ob
    assert drawn(FiltersPanel).startswith("<opacity_min>")  # icons have no number here
    monkeypatch.setattr(histogram_cache.ICONS, "update", lambda ob, kind: 7)
    wanted = "By opacity [picture] By size [picture] <opacity_min> <size_min> <size_max>"
    assert drawn(FiltersPanel).startswith(wanted)


def test_icons_follow_the_filters(scene):
    """Oracle: the picture of the counts and limits."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    for limit in (0.0, 0.5):
        ob.gscore.opacity_min = limit
        histogram_cache.ICONS.update(ob, OPACITY)
        wanted = histogram_cache.HISTOGRAMS.of(ob)[OPACITY].picture(192, 192, limit, 0.0)
        got = np.array(histogram_cache.ICONS._icons[OPACITY].image_pixels_float[:]).reshape(
            192, 192, 4
        )
        np.testing.assert_allclose(got, wanted, atol=1 / 255)


def test_splats_without_sizes_have_no_histograms(scene, kept):
    """Oracle: the panel's text, with a missing attribute and with NaN."""
    lab.prepare(scene)
    ob = lab.add(scene, lab.blob())
    bpy.context.view_layer.objects.active = ob
    ob.data.attributes[attributes.SCALE].data[7].vector.x = np.nan
    assert kept.of(ob) == {}
    ob.data.attributes.remove(ob.data.attributes[attributes.SCALE])
    kept.forget({ob.data.session_uid})
    assert kept.of(ob) == {}
    assert drawn(FiltersPanel).startswith("<opacity_min>")

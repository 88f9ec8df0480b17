"""Users' data on a mesh of splats that is replaced. Oracles: the data, and that animation still
plays."""

from collections.abc import Callable

import bpy
import numpy as np
import pytest

from addon import attributes
from addon.splats import objects, read_chunked
from addon.splats.write_chunked import replace
from addon.timeline import mesh as frames
from tests.addon import splat_scenes as lab

COUNT = 300
CATALOG = "12345678-1234-1234-1234-123456789abc"
EDITS = {
    "separate_splats": {},
    "join_splats": {},
    "decimate_splats": {"count": 100},
    "apply_filters": {},
    "apply_splat_transform": {},
    "mend_splats": {},
}
"""Edits of splats that give an object another mesh, and their settings."""


@pytest.fixture
def ob(scene: bpy.types.Scene) -> bpy.types.Object:
    """Active splats on which each edit has an effect; another object to join is selected."""
    lab.prepare(scene)
    made = lab.add(scene, lab.blob(COUNT), "splats")
    attributes.select(made.data, np.arange(COUNT) % 7 == 3)
    made.gscore.opacity_min = 0.5
    make_active(made)
    return made


def make_active(*obs: bpy.types.Object) -> None:
    """Select only these objects; the first is active."""
    bpy.context.view_layer.update()  # to update it with new objects
    for one in bpy.context.view_layer.objects:
        one.select_set(one in obs)
    bpy.context.view_layer.objects.active = obs[0]
    bpy.context.view_layer.update()


def furnish(mesh: bpy.types.Mesh, *, chosen: bool = False) -> None:
    """Add users' data to a mesh; `chosen`: with attributes too."""
    if chosen:
        for name in ("tint", "shade"):
            mesh.attributes.new(name, "FLOAT_COLOR", "POINT")
        mesh.attributes.active = mesh.attributes["tint"]
        mesh.attributes.active_color_name = "tint"
        mesh.attributes.default_color_name = "shade"
    mesh["one"], mesh["other"], mesh["words"] = 1.0, 1.0, "of mine"
    mesh["inner"] = {"deep": [1, 2, 3]}
    mesh.id_properties_ui("one").update(max=7.0, description="What it is")
    mesh.keyframe_insert('["one"]', frame=1)
    mesh.driver_add('["other"]').driver.expression = "frame + 1"
    mesh.materials.append(bpy.data.materials.new("mine"))
    mesh.asset_mark()
    about = mesh.asset_data
    about.author, about.description, about.license = "me", "splats of mine", "CC0"
    about.catalog_id = CATALOG
    for name in ("red", "toy"):
        about.tags.new(name)


def put(mesh: bpy.types.Mesh) -> dict[str, object]:
    """The data of `furnish`, except for the asset mark."""
    animated, own, limits = mesh.animation_data, mesh.attributes, mesh.id_properties_ui("one")
    slot = getattr(animated, "action_slot", None)
    return {
        "properties": [mesh["one"], mesh["other"], mesh["words"], list(mesh["inner"]["deep"])],
        "limits": [limits.as_dict()[key] for key in ("max", "description")],
        "action": [animated.action, slot and slot.identifier],
        "drivers": [(d.data_path, d.driver.expression) for d in animated.drivers],
        "materials": list(mesh.materials),
        "chosen": [own.active_color_name, own.default_color_name] if "tint" in own else [],
    }


def mark(mesh: bpy.types.Mesh) -> object:
    """The asset data; None: not an asset."""
    about = mesh.asset_data
    if about is None:
        return None
    texts = about.author, about.description, about.license, about.catalog_id
    return texts, [tag.name for tag in about.tags], mesh.use_fake_user


def check_plays(mesh: bpy.types.Mesh) -> None:
    """Its action and its driver change its properties."""
    mesh["one"] = 5.0
    bpy.context.scene.frame_set(7)
    assert (mesh["one"], mesh["other"]) == (1.0, 8.0)


def ready(ob: bpy.types.Object, edit: str) -> None:
    """Prepare data on which an edit has an effect."""
    if edit == "join_splats":
        make_active(ob, lab.add(bpy.context.scene, lab.blob(40, seed=2), "another"))
    elif edit == "apply_splat_transform":
        ob.location = (1, 0, 0)
    elif edit == "mend_splats":
        ob.rotation_euler = (1, 0.2, 0.1)
        bpy.context.view_layer.update()
        bpy.ops.object.transform_apply()
    bpy.context.view_layer.update()


@pytest.mark.parametrize("edit", EDITS)
def test_edits_keep_it(ob: bpy.types.Object, edit: str) -> None:
    """Also on a separated part, which does not become a second asset."""
    furnish(ob.data, chosen=True)
    ready(ob, edit)
    before, marked, name, old = put(ob.data), mark(ob.data), ob.data.name, ob.data.session_uid
    assert marked is not None
    count = len(ob.data.vertices)
    assert getattr(bpy.ops.gscore, edit)(**EDITS[edit]) == {"FINISHED"}
    assert ob.data.session_uid != old and ob.data.name == name
    changes = edit not in ("apply_splat_transform", "mend_splats")
    assert (len(ob.data.vertices) != count) == changes
    for one in filter(objects.is_splats, bpy.data.objects):
        assert put(one.data) == before
        assert mark(one.data) == (marked if one == ob else None)
    for one in filter(objects.is_splats, bpy.data.objects):
        check_plays(one.data)


def test_undo_brings_the_asset_back(ob: bpy.types.Object) -> None:
    """And redo does."""
    furnish(ob.data)
    marked = mark(ob.data)
    bpy.ops.ed.undo_push(message="Furnish")
    bpy.ops.gscore.decimate_splats(count=100)
    bpy.ops.ed.undo_push(message="Decimate")
    for step, count in ((bpy.ops.ed.undo, COUNT), (bpy.ops.ed.redo, 100)):
        step()
        mesh = bpy.data.objects["splats"].data
        assert len(mesh.vertices) == count and mark(mesh) == marked
        assert [m.name for m in bpy.data.meshes if m.asset_data] == [mesh.name]


def by_refresh(ob: bpy.types.Object, count: int) -> None:
    """Other splats in the same mesh."""
    objects.refresh(ob, lab.blob(count, seed=3))


def by_replace(ob: bpy.types.Object, count: int) -> None:
    """A new mesh, as for results of trainings."""
    other = objects.create(lab.blob(count, seed=3), "other")
    replace(ob, other.data)
    bpy.data.objects.remove(other)


def by_exchange(ob: bpy.types.Object, count: int) -> None:
    """The same for the frame of a sequence."""
    other = objects.create(lab.blob(count, seed=3), "other")
    mesh = other.data
    bpy.data.objects.remove(other)
    frames.exchange(ob, mesh)


WAYS = by_refresh, by_replace, by_exchange
Way = Callable[[bpy.types.Object, int], None]


@pytest.mark.parametrize("count", [COUNT, 120])
@pytest.mark.parametrize("way", WAYS)
def test_other_splats_keep_it(ob: bpy.types.Object, way: Way, count: int) -> None:
    """And no data about the earlier points."""
    ob.data["gs_frame"] = "3 of earlier ones"
    furnish(ob.data)
    before, marked = put(ob.data), mark(ob.data)
    way(ob, count)
    assert len(ob.data.vertices) == count
    assert put(ob.data) == before and mark(ob.data) == marked
    assert way is by_refresh or "gs_frame" not in ob.data
    assert [m for m in bpy.data.meshes if m != ob.data] == []
    check_plays(ob.data)


def test_copies_of_an_asset_play_without_it(ob: bpy.types.Object) -> None:
    """A mesh with other users stays theirs, with the mark; the frame's mesh has all other data."""
    twin = ob.copy()
    bpy.context.scene.collection.objects.link(twin)
    furnish(ob.data)
    before, marked, shared = put(ob.data), mark(ob.data), ob.data
    by_exchange(twin, 120)
    assert ob.data == shared and mark(shared) == marked and len(shared.vertices) == COUNT
    assert put(twin.data) == before and mark(twin.data) is None


def key(ob: bpy.types.Object) -> None:
    """Shape keys."""
    ob.shape_key_add(name="Basis")


def edge(ob: bpy.types.Object) -> None:
    """An edge."""
    ob.data.edges.add(1)
    ob.data.edges[0].vertices = 0, 1


def track(ob: bpy.types.Object) -> None:
    """An NLA track."""
    ob.data.animation_data_create().nla_tracks.new()


@pytest.mark.parametrize("edit", EDITS)
@pytest.mark.parametrize(("give", "why"), [(key, "has shape keys"), (edge, "has edges or faces")])
def test_lossy_edits_are_refused_before_reading(
    ob: bpy.types.Object,
    monkeypatch: pytest.MonkeyPatch,
    edit: str,
    give: Callable[[bpy.types.Object], None],
    why: str,
) -> None:
    """Oracle: the error; reading, which takes seconds for a million splats, is not begun; nothing
    changes. Edits of positions only keep an edge."""
    ready(ob, edit)
    give(ob)
    bpy.context.view_layer.update()
    if give is edge and edit in ("apply_splat_transform", "mend_splats"):
        assert getattr(bpy.ops.gscore, edit)() == {"FINISHED"}
        assert len(ob.data.edges) == 1
        return
    before, meshes = ob.data, len(bpy.data.meshes)

    def read(*_: object) -> None:
        pytest.fail("it is read")

    monkeypatch.setattr(read_chunked.ChunkedRead, "__init__", read)
    said = lab.error_of(lambda: getattr(bpy.ops.gscore, edit)(**EDITS[edit]))
    assert f"splats {why}" in said
    assert ob.data == before and len(ob.data.vertices) == COUNT
    assert len(bpy.data.meshes) == meshes
    assert len(ob.data.edges) == (give is edge)


@pytest.mark.parametrize(("give", "why"), [(key, "has shape keys"), (edge, "has edges or faces")])
def test_join_refuses_to_remove_objects(
    ob: bpy.types.Object, give: Callable[[bpy.types.Object], None], why: str
) -> None:
    """Oracle: the message names the object that would be removed, and it stays."""
    ready(ob, "join_splats")
    give(bpy.data.objects["another"])
    bpy.context.view_layer.update()
    assert f"another {why}" in lab.error_of(bpy.ops.gscore.join_splats)
    assert len(ob.data.vertices) == COUNT and len(bpy.data.objects["another"].data.vertices) == 40


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("give", [key, edge, track])
def test_other_splats_refuse_what_would_be_lost(
    ob: bpy.types.Object, way: Way, give: Callable[[bpy.types.Object], None]
) -> None:
    """Oracle: the unchanged mesh; only a new mesh would lose tracks."""
    give(ob)
    before = ob.data
    if way is by_refresh and give is track:
        way(ob, 120)
        assert len(ob.data.vertices) == 120
    else:
        with pytest.raises(ValueError, match=r"splats has"):
            way(ob, 120)
        assert ob.data == before and len(ob.data.vertices) == COUNT
    tracks = ob.data.animation_data.nla_tracks if give is track else ()
    assert (ob.data.shape_keys is not None, len(ob.data.edges), len(tracks)) == (
        give is key,
        int(give is edge),
        int(give is track),
    )


def test_edits_keep_tracks(ob: bpy.types.Object) -> None:
    """Oracle: the track and its strip, in the mesh of fewer splats."""
    furnish(ob.data)
    animated = ob.data.animation_data
    animated.nla_tracks.new().strips.new("mine", 3, animated.action)
    bpy.ops.gscore.decimate_splats(count=100)
    [one] = ob.data.animation_data.nla_tracks
    assert [(strip.name, strip.frame_start) for strip in one.strips] == [("mine", 3)]

"""A .blend file saved by an earlier version; oracle: what Blender listed when it was saved."""

import json
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon.core import Splats
from tests.addon.stored_names import stored_names

SAVED = Path(__file__).parents[1] / "saved_before"

pytestmark = pytest.mark.skipif(bpy.app.version < (5, 3), reason="the file is of Blender 5.3")


@pytest.fixture
def facts(tmp_path: Path) -> dict:
    """The file, opened; its capture and run are not there."""
    path = tmp_path / "saved.blend"
    path.write_bytes((SAVED / "saved.blend").read_bytes())
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return json.loads((SAVED / "saved.json").read_text())


def test_settings_objects_and_nodes_are_there(facts: dict) -> None:
    """Oracle: every setting, custom property, attribute, modifier, node group and collection;
    *Sky* was a checkbox, which is now the choice of a sphere."""
    scene, splats = bpy.context.scene, bpy.data.objects["point_cloud"]
    wrong = []
    for place, name, kind, value in facts["settings"]:
        owner = {"scene": scene, "splats": splats}[place.partition(".")[0]]
        found = getattr(getattr(owner, place.partition(".")[2]), name)
        value = "on" if name == "sky" and value is True else value
        if kind == "FLOAT":
            same = np.allclose(found, value)
        else:
            same = (list(found) if isinstance(value, list) else found) == value
        if not same:
            wrong.append((place, name, value, found))
    assert wrong == []
    assert {o.name for o in bpy.data.objects} == set(facts["objects"])
    for name, keys in facts["objects"].items():
        assert set(keys) <= set(bpy.data.objects[name].keys()), name
    assert set(facts["attributes"]) <= set(splats.data.attributes.keys())
    assert [m.name for m in splats.modifiers] == facts["modifiers"]
    assert set(facts["node_groups"]) <= {g.name for g in bpy.data.node_groups}
    assert set(facts["collections"]) <= {c.name for c in bpy.data.collections}


def test_no_stored_name_is_gone(built_anew: None, make_splats: Callable[..., Splats]) -> None:
    """Oracle: the names when the list was written: operators, properties, items, node groups and
    their sockets, attributes. To add new ones, write `stored_names` to names.json again."""
    kept, found = json.loads((SAVED / "names.json").read_text()), stored_names(make_splats(2, 24))
    gone = {kind: sorted(set(names) - set(found[kind])) for kind, names in kept.items()}
    assert {kind: names for kind, names in gone.items() if names} == {}


def test_it_renders(facts: dict, tmp_path: Path) -> None:
    """Oracle: a picture of the engine that the file names, which is not of one colour."""
    scene = bpy.context.scene
    scene.camera = next(ob for ob in bpy.data.objects if ob.type == "CAMERA")
    scene.render.resolution_x, scene.render.resolution_y = 60, 80
    scene.render.filepath = str(tmp_path / "picture.png")
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(scene.render.filepath)
    pixels = np.array(picture.pixels[:]).reshape(-1, 4)[:, :3]
    assert scene.render.engine == "GSCORE_SPLATS" and pixels.std() > 0.02

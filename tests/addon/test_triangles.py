"""Triangles of meshes. Oracle: Blender's loop triangles and vertices."""

import ctypes

import bpy
import numpy as np
import pytest

from addon.triangles import triangles_of


@pytest.mark.parametrize("kind", ["triangles", "mixed", "by name", "wire", "none"])
def test_triangles_are_blenders(scene, kind, monkeypatch):
    """Of triangles alone, beside quads and a circle, and without faces; also by name, as where
    triangles are not an array in memory."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=2)
    ob = bpy.context.object
    mesh = ob.data
    copied = []
    if kind in {"mixed", "by name"}:
        bpy.ops.mesh.primitive_cube_add()
        others = [bpy.context.object]
        bpy.ops.mesh.primitive_circle_add(vertices=7, fill_type="NGON")
        others.append(bpy.context.object)
        with bpy.context.temp_override(active_object=ob, selected_editable_objects=[ob, *others]):
            bpy.ops.object.join()
        copy = ctypes.memmove if kind == "mixed" else lambda *_: None
        monkeypatch.setattr(ctypes, "memmove", lambda *given: copied.append(copy(*given)))
    if kind in {"wire", "none"}:
        mesh.clear_geometry()
        if kind == "wire":
            mesh.from_pydata([(0, 0, 0), (1, 0, 0)], [(0, 1)], [])
    bpy.context.view_layer.update()
    evaluated = ob.evaluated_get(bpy.context.evaluated_depsgraph_get())
    found = triangles_of(evaluated)
    mesh.calc_loop_triangles()
    triangles = np.array([tuple(t.vertices) for t in mesh.loop_triangles], np.int32).reshape(-1, 3)
    np.testing.assert_array_equal(found.triangles, triangles)
    assert bool(copied) == (kind in {"mixed", "by name"})
    places = np.array([tuple(v.co) for v in mesh.vertices]).reshape(-1, 3)
    np.testing.assert_array_equal(found.vertices, places)

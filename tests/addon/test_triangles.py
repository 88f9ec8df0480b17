"""Triangles of meshes. Oracle: Blender's loop triangles and vertices."""

import bpy
import numpy as np
import pytest

from addon.triangles import triangles_of


@pytest.mark.parametrize("kind", ["triangles", "mixed", "wire", "none"])
def test_triangles_are_blenders(scene, kind):
    """Of triangles alone, beside quads, and without faces."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=2)
    ob = bpy.context.object
    mesh = ob.data
    if kind == "mixed":
        bpy.ops.mesh.primitive_cube_add()
        other = bpy.context.object
        with bpy.context.temp_override(active_object=ob, selected_editable_objects=[ob, other]):
            bpy.ops.object.join()
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
    places = np.array([tuple(v.co) for v in mesh.vertices]).reshape(-1, 3)
    np.testing.assert_array_equal(found.vertices, places)

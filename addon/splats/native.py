"""A copy of a splat object as Blender's own Gaussian splats, where Blender has them (5.3)."""

import bpy
from mathutils import Matrix

from .. import attributes, compat
from ..core import Splats
from ..interface import writable
from . import objects

KIND = "native"


def make_native(ob: bpy.types.Object) -> bpy.types.Object:
    """Make (again) the native copy of what a splat object shows, and let it be displayed instead.

    The copy is a child of the object and moves with it.

    Raises:
        ValueError: this Blender has no native splats, or attributes are missing.
    """
    kind = compat.native_splat_type()
    if kind is None:
        raise ValueError(
            f"Blender {bpy.app.version_string} has no Gaussian splats of its own; they came with "
            f"5.3. Use the displays Points, Ellipsoids or Soft Splats."
        )
    cloud = point_cloud(objects.read(ob, filtered=True), f"{ob.name} Native")
    setattr(cloud, *kind)
    for old in [child for child in ob.children if child.get("gs_kind") == KIND]:
        bpy.data.pointclouds.remove(old.data)
    native = bpy.data.objects.new(cloud.name, cloud)
    native["gs_kind"] = KIND
    native.parent, native.matrix_parent_inverse = ob, Matrix.Identity(4)
    writable.link_beside(native, ob)
    ob.gscore.display = "NATIVE"
    return native


def point_cloud(splats: Splats, name: str) -> bpy.types.PointCloud:
    """A point cloud with the attributes Blender's splats have; needs Blender 5.1."""
    cloud = bpy.data.pointclouds.new(name)
    cloud.resize(len(splats))
    attributes.write(cloud, splats, base_type="FLOAT4")
    cloud.update_tag()
    return cloud

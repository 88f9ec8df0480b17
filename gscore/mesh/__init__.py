"""Surfaces of splats: depths of many views fused into a triangle mesh with colours."""

from .make_mesh import MeshRequest, make_mesh
from .surface_mesh import SurfaceMesh, read_surface, write_surface

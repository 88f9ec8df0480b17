"""Edits of splats after a training: crop, cleanup, pruning, merge, transform."""

from ..importance import importance_of, most_important
from .clusters import cluster_sizes, reached_from
from .crop import box_matrix, in_frustum, in_unit_shape, sphere_matrix
from .measures import at_least_opaque, contributions, isolation_of, of_size, similarity_matrix

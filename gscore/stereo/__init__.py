"""Multi-view stereo: depth maps from photos with known cameras."""

from .cloud import dense_points
from .maps import StereoMaps, stereo_maps

"""Multi-view stereo: depth maps from photos with known cameras."""

from .maps import StereoMaps, dense_points, stereo_maps

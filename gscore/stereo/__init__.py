"""Depth from the photos themselves: multi-view stereo over cameras that are known."""

from .cloud import dense_points
from .maps import StereoMaps, stereo_maps

__all__ = ["StereoMaps", "dense_points", "stereo_maps"]

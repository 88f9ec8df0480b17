"""Cameras and points found from photos alone; pycolmap does the work."""

from .find import Found, find_cameras
from .request import Request

__all__ = ["Found", "Request", "find_cameras"]

"""Cameras and points found from photos alone; pycolmap does the work."""

from .camera_search import SearchResult, find_cameras
from .search_request import SearchRequest

__all__ = ["SearchRequest", "SearchResult", "find_cameras"]

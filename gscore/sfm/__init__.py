"""Structure from motion: cameras and points from photos, by pycolmap."""

from .camera_search import SearchResult, find_cameras
from .search_request import SearchRequest

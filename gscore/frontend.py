"""Front-end interface in addition to `gscore`: events, runs, inspection, COLMAP, estimates.

The Blender add-on uses only these names. A name is loaded on first use.
"""

from typing import TYPE_CHECKING, Any

from .extras import offered

if TYPE_CHECKING:
    from .config import Stereo, Switch
    from .datasets import Capture, Folder, View, read_capture
    from .datasets.camera_path_json import read_camera_path, write_nerfstudio_path
    from .datasets.frames import SequenceFrame, choose_frames, find_frames, frame_pattern
    from .datasets.mask_meaning import are_mattes
    from .datasets.masks import masks_inside
    from .datasets.photo_headers import up_from_exif
    from .datasets.resolution import target_size
    from .datasets.undistort import Undistortion, plan_undistortion
    from .depth.catalogue import KnownNetwork
    from .depth.catalogue import all_networks as depth_networks
    from .depth.stated import StatedDepth, stated_depth
    from .edit import (
        at_least_opaque,
        cluster_sizes,
        contributions,
        importance_of,
        in_unit_shape,
        isolation_of,
        most_important,
        of_size,
        reached_from,
    )
    from .edit.pipeline import EditViews, apply_edits
    from .edit.request import EditRequest
    from .events import (
        DepthDone,
        DepthProgress,
        Done,
        Estimated,
        Eval,
        EvalDone,
        EvalProgress,
        Failed,
        FramesDone,
        FramesProgress,
        FrameStarted,
        Preview,
        Progress,
        Saved,
        SequenceDone,
        SfmDone,
        SfmEstimated,
        SfmProgress,
        Snapshot,
        Started,
        Warn,
        from_line,
    )
    from .formats import SPLAT_ENDINGS, SplatFile, is_antialiased
    from .formats.joined import joined as join_splats
    from .glsl import glsl_defines
    from .inspection import CaptureFacts, Problem, find_capture
    from .inspection import inspect as inspect_capture
    from .io.cameras_json import read_cameras_json as read_cameras
    from .io.cameras_json import write_cameras
    from .io.colmap.camera_models import NO_PINHOLE
    from .io.colmap.folder import find_model as find_colmap
    from .io.colmap.folder import read_model as read_colmap
    from .io.colmap.folder import write_model as write_colmap
    from .io.colmap.model import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
    from .io.files import atomic_write, file_errors
    from .io.images.image_header import ImageInfo, read_header
    from .io.images.png import gray_png, rgba_png
    from .io.images.resample import downscale
    from .io.lock import FolderLock
    from .io.lod_file import LOD_ENDING, is_lod_file
    from .io.mesh.ply import write_mesh
    from .io.ply.splats import MIP_COMMENT
    from .io.ply.up_axis import UP_NOTE, stated_up
    from .io.poses_json import POSES_FILE, read_moves
    from .io.region_file import write_region
    from .io.runs import GUIDE_FILE, GUIDES, RunInfo, clear_run, read_course, read_run
    from .io.sequences import SequenceIndex, read_sequence
    from .lod.build import LodFacts, build_lod
    from .lod.lod_renderer import LodModel
    from .lod.read import read_lod
    from .option_marks import show_options
    from .options import Option, options_of
    from .raster.mesh import mesh_depth
    from .report.colormap import colorize
    from .scene import moved_viewmats, offset_between, origin_words
    from .sfm.output_path import default_capture_output
    from .sh import rgb_to_sh0, sh0_to_rgb, sh_basis
    from .splats import cut_degree
    from .trainer.estimate.forecast import Estimate, estimate
    from .trainer.schedule.caps import cap_by_photos, expected_points
    from .transforms import quat_to_rotmat, rotmat_to_quat
    from .upright import find_up
    from .video import VIDEO_ENDINGS, is_video
    from .warning_log import collected_warnings

_HOME = {
    "Capture": "datasets",
    "CaptureFacts": "inspection",
    "ColmapCamera": "io.colmap.model",
    "ColmapImage": "io.colmap.model",
    "ColmapModel": "io.colmap.model",
    "ColmapPoints": "io.colmap.model",
    "DepthDone": "events",
    "DepthProgress": "events",
    "Done": "events",
    "EditRequest": "edit.request",
    "EditViews": "edit.pipeline",
    "Estimate": "trainer.estimate.forecast",
    "Estimated": "events",
    "Eval": "events",
    "EvalDone": "events",
    "EvalProgress": "events",
    "Failed": "events",
    "Folder": "datasets",
    "FolderLock": "io.lock",
    "FrameStarted": "events",
    "FramesDone": "events",
    "FramesProgress": "events",
    "GUIDES": "io.runs",
    "GUIDE_FILE": "io.runs",
    "ImageInfo": "io.images.image_header",
    "KnownNetwork": "depth.catalogue",
    "LOD_ENDING": "io.lod_file",
    "LodFacts": "lod.build",
    "LodModel": "lod.lod_renderer",
    "MIP_COMMENT": "io.ply.splats",
    "NO_PINHOLE": "io.colmap.camera_models",
    "Option": "options",
    "POSES_FILE": "io.poses_json",
    "SPLAT_ENDINGS": "formats",
    "Preview": "events",
    "Problem": "inspection",
    "Progress": "events",
    "RunInfo": "io.runs",
    "Saved": "events",
    "SequenceDone": "events",
    "SequenceFrame": "datasets.frames",
    "SequenceIndex": "io.sequences",
    "SfmDone": "events",
    "SfmEstimated": "events",
    "SfmProgress": "events",
    "Snapshot": "events",
    "SplatFile": "formats",
    "Started": "events",
    "StatedDepth": "depth.stated",
    "Stereo": "config",
    "Switch": "config",
    "UP_NOTE": "io.ply.up_axis",
    "Undistortion": "datasets.undistort",
    "VIDEO_ENDINGS": "video",
    "View": "datasets",
    "Warn": "events",
    "apply_edits": "edit.pipeline",
    "are_mattes": "datasets.mask_meaning",
    "at_least_opaque": "edit",
    "atomic_write": "io.files",
    "build_lod": "lod.build",
    "default_capture_output": "sfm.output_path",
    "choose_frames": "datasets.frames",
    "clear_run": "io.runs",
    "collected_warnings": "warning_log",
    "cluster_sizes": "edit",
    "colorize": "report.colormap",
    "contributions": "edit",
    "cut_degree": "splats",
    "depth_networks": "depth.catalogue:all_networks",
    "downscale": "io.images.resample",
    "cap_by_photos": "trainer.schedule.caps",
    "expected_points": "trainer.schedule.caps",
    "estimate": "trainer.estimate.forecast",
    "find_capture": "inspection",
    "find_colmap": "io.colmap.folder:find_model",
    "find_frames": "datasets.frames",
    "find_up": "upright",
    "frame_pattern": "datasets.frames",
    "from_line": "events",
    "file_errors": "io.files",
    "glsl_defines": "glsl",
    "gray_png": "io.images.png",
    "importance_of": "edit",
    "in_unit_shape": "edit",
    "inspect_capture": "inspection:inspect",
    "is_antialiased": "formats",
    "is_lod_file": "io.lod_file",
    "is_video": "video",
    "isolation_of": "edit",
    "join_splats": "formats.joined:joined",
    "masks_inside": "datasets.masks",
    "mesh_depth": "raster.mesh",
    "most_important": "edit",
    "moved_viewmats": "scene",
    "of_size": "edit",
    "offset_between": "scene",
    "origin_words": "scene",
    "options_of": "options",
    "plan_undistortion": "datasets.undistort",
    "reached_from": "edit",
    "read_camera_path": "datasets.camera_path_json",
    "read_cameras": "io.cameras_json:read_cameras_json",
    "read_capture": "datasets",
    "read_colmap": "io.colmap.folder:read_model",
    "read_header": "io.images.image_header",
    "read_lod": "lod.read",
    "read_moves": "io.poses_json",
    "read_course": "io.runs",
    "read_run": "io.runs",
    "read_sequence": "io.sequences",
    "quat_to_rotmat": "transforms",
    "rgb_to_sh0": "sh",
    "rgba_png": "io.images.png",
    "rotmat_to_quat": "transforms",
    "sh0_to_rgb": "sh",
    "sh_basis": "sh",
    "show_options": "option_marks",
    "stated_depth": "depth.stated",
    "stated_up": "io.ply.up_axis",
    "target_size": "datasets.resolution",
    "up_from_exif": "datasets.photo_headers",
    "write_cameras": "io.cameras_json",
    "write_colmap": "io.colmap.folder:write_model",
    "write_mesh": "io.mesh.ply",
    "write_nerfstudio_path": "datasets.camera_path_json",
    "write_region": "io.region_file",
}
"""Module of each name; `module:name` if it has another name there."""

__all__ = [
    "GUIDES",
    "GUIDE_FILE",
    "LOD_ENDING",
    "MIP_COMMENT",
    "NO_PINHOLE",
    "POSES_FILE",
    "SPLAT_ENDINGS",
    "UP_NOTE",
    "VIDEO_ENDINGS",
    "Capture",
    "CaptureFacts",
    "ColmapCamera",
    "ColmapImage",
    "ColmapModel",
    "ColmapPoints",
    "DepthDone",
    "DepthProgress",
    "Done",
    "EditRequest",
    "EditViews",
    "Estimate",
    "Estimated",
    "Eval",
    "EvalDone",
    "EvalProgress",
    "Failed",
    "Folder",
    "FolderLock",
    "FrameStarted",
    "FramesDone",
    "FramesProgress",
    "ImageInfo",
    "KnownNetwork",
    "LodFacts",
    "LodModel",
    "Option",
    "Preview",
    "Problem",
    "Progress",
    "RunInfo",
    "Saved",
    "SequenceDone",
    "SequenceFrame",
    "SequenceIndex",
    "SfmDone",
    "SfmEstimated",
    "SfmProgress",
    "Snapshot",
    "SplatFile",
    "Started",
    "StatedDepth",
    "Stereo",
    "Switch",
    "Undistortion",
    "View",
    "Warn",
    "apply_edits",
    "are_mattes",
    "at_least_opaque",
    "atomic_write",
    "build_lod",
    "cap_by_photos",
    "choose_frames",
    "clear_run",
    "cluster_sizes",
    "collected_warnings",
    "colorize",
    "contributions",
    "cut_degree",
    "default_capture_output",
    "depth_networks",
    "downscale",
    "estimate",
    "expected_points",
    "file_errors",
    "find_capture",
    "find_colmap",
    "find_frames",
    "find_up",
    "frame_pattern",
    "from_line",
    "glsl_defines",
    "gray_png",
    "importance_of",
    "in_unit_shape",
    "inspect_capture",
    "is_antialiased",
    "is_lod_file",
    "is_video",
    "isolation_of",
    "join_splats",
    "masks_inside",
    "mesh_depth",
    "most_important",
    "moved_viewmats",
    "of_size",
    "offset_between",
    "options_of",
    "origin_words",
    "plan_undistortion",
    "quat_to_rotmat",
    "reached_from",
    "read_camera_path",
    "read_cameras",
    "read_capture",
    "read_colmap",
    "read_course",
    "read_header",
    "read_lod",
    "read_moves",
    "read_run",
    "read_sequence",
    "rgb_to_sh0",
    "rgba_png",
    "rotmat_to_quat",
    "sh0_to_rgb",
    "sh_basis",
    "show_options",
    "stated_depth",
    "stated_up",
    "target_size",
    "up_from_exif",
    "write_cameras",
    "write_colmap",
    "write_mesh",
    "write_nerfstudio_path",
    "write_region",
]


def __getattr__(name: str) -> Any:
    return offered(__name__, name, _HOME)


def __dir__() -> list[str]:
    return __all__

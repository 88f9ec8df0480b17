# Names of `gscore.frontend`: module of each; a line a name, read by `extras.stub_name`.

from .config import Stereo as Stereo
from .config import Switch as Switch
from .datasets import Capture as Capture
from .datasets import Folder as Folder
from .datasets import View as View
from .datasets import read_capture as read_capture
from .datasets.camera_path_json import read_camera_path as read_camera_path
from .datasets.camera_path_json import write_nerfstudio_path as write_nerfstudio_path
from .datasets.frames import SequenceFrame as SequenceFrame
from .datasets.frames import choose_frames as choose_frames
from .datasets.frames import find_frames as find_frames
from .datasets.frames import frame_pattern as frame_pattern
from .datasets.masks import are_mattes as are_mattes
from .datasets.masks import masks_inside as masks_inside
from .datasets.photo_headers import up_from_exif as up_from_exif
from .datasets.resolution import target_size as target_size
from .datasets.undistort import Undistortion as Undistortion
from .datasets.undistort import plan_undistortion as plan_undistortion
from .depth.catalogue import KnownNetwork as KnownNetwork
from .depth.catalogue import all_networks
from .depth.stated import StatedDepth as StatedDepth
from .depth.stated import stated_depth as stated_depth
from .edit import at_least_opaque as at_least_opaque
from .edit import cluster_sizes as cluster_sizes
from .edit import contributions as contributions
from .edit import importance_of as importance_of
from .edit import in_unit_shape as in_unit_shape
from .edit import isolation_of as isolation_of
from .edit import most_important as most_important
from .edit import of_size as of_size
from .edit import reached_from as reached_from
from .edit.pipeline import EditViews as EditViews
from .edit.pipeline import apply_edits as apply_edits
from .edit.request import EditRequest as EditRequest
from .events import Decision as Decision
from .events import DepthDone as DepthDone
from .events import DepthProgress as DepthProgress
from .events import Done as Done
from .events import Estimated as Estimated
from .events import Eval as Eval
from .events import EvalDone as EvalDone
from .events import EvalProgress as EvalProgress
from .events import Failed as Failed
from .events import FramesDone as FramesDone
from .events import FramesProgress as FramesProgress
from .events import FrameStarted as FrameStarted
from .events import MeshDone as MeshDone
from .events import MeshPlanned as MeshPlanned
from .events import MeshProgress as MeshProgress
from .events import Preview as Preview
from .events import Progress as Progress
from .events import RefitDone as RefitDone
from .events import RefitProgress as RefitProgress
from .events import Saved as Saved
from .events import SequenceDone as SequenceDone
from .events import SfmDone as SfmDone
from .events import SfmEstimated as SfmEstimated
from .events import SfmProgress as SfmProgress
from .events import Snapshot as Snapshot
from .events import Started as Started
from .events import Warn as Warn
from .events import from_line as from_line
from .formats import SPLAT_ENDINGS as SPLAT_ENDINGS
from .formats import SplatFile as SplatFile
from .formats import is_antialiased as is_antialiased
from .formats.joined import joined
from .glsl import glsl_defines as glsl_defines
from .inspection import CaptureFacts as CaptureFacts
from .inspection import Problem as Problem
from .inspection import find_capture as find_capture
from .inspection import inspect
from .io.cameras_json import read_cameras_json
from .io.cameras_json import write_cameras as write_cameras
from .io.colmap.folder import find_model, read_model, write_model
from .io.colmap.lenses import NO_PINHOLE as NO_PINHOLE
from .io.colmap.model import ColmapCamera as ColmapCamera
from .io.colmap.model import ColmapImage as ColmapImage
from .io.colmap.model import ColmapModel as ColmapModel
from .io.colmap.model import ColmapPoints as ColmapPoints
from .io.exposure_json import read_gains as read_gains
from .io.files import atomic_write as atomic_write
from .io.files import file_errors as file_errors
from .io.images.image_header import ImageInfo as ImageInfo
from .io.images.image_header import read_header as read_header
from .io.images.png import png_bytes as png_bytes
from .io.images.resample import downscale as downscale
from .io.lock import FolderLock as FolderLock
from .io.lod_file import LOD_ENDING as LOD_ENDING
from .io.lod_file import is_lod_file as is_lod_file
from .io.mesh.files import write_mesh as write_mesh
from .io.ply.comments import UP_NOTE as UP_NOTE
from .io.ply.comments import stated_up as stated_up
from .io.ply.splats import MIP_COMMENT as MIP_COMMENT
from .io.poses_json import POSES_FILE as POSES_FILE
from .io.poses_json import read_moves as read_moves
from .io.region_file import write_region as write_region
from .io.runs import GUIDE_FILE as GUIDE_FILE
from .io.runs import GUIDES as GUIDES
from .io.runs import RunInfo as RunInfo
from .io.runs import clear_run as clear_run
from .io.runs import read_course as read_course
from .io.runs import read_run as read_run
from .io.sequences import SequenceIndex as SequenceIndex
from .io.sequences import read_sequence as read_sequence
from .lod.build import LodFacts as LodFacts
from .lod.build import build_lod as build_lod
from .lod.lod_renderer import LodModel as LodModel
from .lod.read import read_lod as read_lod
from .mesh.surface_mesh import SurfaceMesh as SurfaceMesh
from .mesh.surface_mesh import read_surface as read_surface
from .option_marks import show_options as show_options
from .options import Option as Option
from .options import options_of as options_of
from .raster.mesh import mesh_depth as mesh_depth
from .raster.render_client import RenderClient as RenderClient
from .raster.render_client import find_devices as find_devices
from .raster.render_messages import NoDeviceError as NoDeviceError
from .raster.render_messages import RenderServerError as RenderServerError
from .report.colormap import colorize as colorize
from .scene import moved_viewmats as moved_viewmats
from .scene import offset_between as offset_between
from .scene import origin_text as origin_text
from .sfm.output_path import default_capture_output as default_capture_output
from .sh import rgb_to_sh0 as rgb_to_sh0
from .sh import sh0_to_rgb as sh0_to_rgb
from .sh import sh_basis as sh_basis
from .splats import cut_degree as cut_degree
from .text_format import trust_text as trust_text
from .trainer.estimate.forecast import Estimate as Estimate
from .trainer.estimate.forecast import estimate as estimate
from .trainer.schedule.caps import cap_by_photos as cap_by_photos
from .trainer.schedule.caps import expected_points as expected_points
from .transforms import quat_to_rotmat as quat_to_rotmat
from .transforms import rotmat_to_quat as rotmat_to_quat
from .upright import find_up as find_up
from .video import VIDEO_ENDINGS as VIDEO_ENDINGS
from .video import is_video as is_video
from .warning_log import collected_warnings as collected_warnings

depth_networks = all_networks
find_colmap = find_model
inspect_capture = inspect
join_splats = joined
read_cameras = read_cameras_json
read_colmap = read_model
write_colmap = write_model

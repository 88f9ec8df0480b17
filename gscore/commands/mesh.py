"""`gscore mesh`: the surface of trained splats as a triangle mesh with colours."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..control import Control
from ..datasets import Dataset, load_dataset
from ..errors import Cancelled, ConfigError
from ..events import MeshDone, MeshPlanned, MeshProgress, Show, Warn
from ..io.ply.comments import stated_up
from ..io.region_file import box_of_corners, read_region
from ..mesh.make_mesh import HOLES, SMALL_HOLE, MeshRequest, make_mesh
from ..mesh.surface_mesh import (
    ENDINGS,
    SurfaceMesh,
    check_ending,
    files_written,
    write_surface,
)
from ..mesh.texture import Photo
from ..photo_exposure import NEUTRAL
from ..quoting import brief
from ..scene import Cameras
from ..text_format import count_text
from ..upright import up_axis
from .args.data_options import add_data_options
from .args.device_option import add_device_option, device_of
from .args.model_argument import (
    ModelArgument,
    add_model_argument,
    data_config_of,
    model_path,
    open_model,
)
from .parser import add_option, add_threads_option
from .pictures.render_cameras import captured_cameras
from .terminal.output import check_folder, check_replaced
from .terminal.run_job import OutputOptions, add_output_options, run_verb

_STOPPED = "Stopped; nothing was written."
_FEW = 0.6
"""Share of the seen surfaces below which a mesh has large gaps."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    plain = MeshRequest()
    option = partial(add_option, parser)
    add_model_argument(parser)
    text = f"mesh file: {', '.join(ENDINGS)}; default: mesh.ply in the folder of the run"
    option("-o, --output FILE", text, Path)
    option("-s, --source SOURCE", "capture or cameras.json; default: those of the run", Path)
    option("--overwrite", "replace a file that gscore did not write")
    add_threads_option(parser)
    add_device_option(parser)
    add_output_options(parser, quiet="no progress")
    option = partial(add_option, parser.add_argument_group("surface"))
    option(
        "--voxel X",
        "size of the smallest details, world units; default: two pixels on the nearer surfaces",
        float,
    )
    option(
        "--memory GB",
        "most memory of the volume; default: a quarter of the free memory",
        float,
    )
    option("--far X", "farthest depth, world units; default: twice the nearer surfaces'", float)
    where = parser.add_argument_group("region").add_mutually_exclusive_group()
    add_option(where, "--region FILE", "box, as for gscore train --region", Path)
    add_option(where, "--box X0 Y0 Z0 X1 Y1 Z1", "box between two corners, world units", float)
    option("--between", "draw views between neighbouring photos too (without masks)")
    option = partial(add_option, parser.add_argument_group("mesh"))
    option(
        "--holes",
        f"holes: leave them open, close those of up to {SMALL_HOLE} edges, or all ({plain.holes})",
        choices=HOLES,
        default=plain.holes,
    )
    option(
        "--min-part SHARE",
        "least part to keep, as a share of the largest one's triangles "
        f"({plain.min_part:g}; 0: all)",
        default=plain.min_part,
    )
    option("--smooth STEPS", "steps of smoothing (30; more for voxels below two pixels)", int)
    option("--triangles N", "reduce the mesh to about N triangles (all)", int)
    option(
        "--texture SIZE", "bake a texture of SIZE x SIZE px from the photos, for .glb and .obj", int
    )
    add_data_options(parser)


def run(args: argparse.Namespace) -> int:
    """Make the mesh, write it, and print figures."""
    return run_verb(
        OutputOptions.of(args),
        lambda show, control: _mesh(args, show, control),
        facts=lambda result: result,
        lines=lambda result: [mesh_text(result)],
        stopped=lambda: _STOPPED,
    )


def _mesh(args: argparse.Namespace, show: Show, control: Control) -> dict[str, Any]:
    show(MeshProgress(phase="reading", done=0, total=0))
    region = _region(args)
    request = MeshRequest(
        voxel=args.voxel,
        far=args.far,
        region=region,
        between=args.between,
        holes=args.holes,
        min_part=args.min_part,
        smooth=args.smooth,
        triangles=args.triangles,
        texture=args.texture,
        memory=None if args.memory is None else args.memory * 1e9,
    )
    model = open_model(model_path(args))
    output = args.output or (model.run or model.path.parent) / "mesh.ply"
    has_texture = args.texture is not None
    check_ending(output, texture=has_texture)
    check_folder(output.parent)
    if output.exists() and output.samefile(model.path):
        raise ConfigError(f"{brief(output)} is the model itself; choose another output.")
    check_replaced(files_written(output, texture=has_texture), overwrite=args.overwrite)
    cameras, dataset = _cameras(args, model, show)
    device = device_of(args, cancel=lambda: control.stopping, warn=False)
    for sentence in (*model.warnings, *filter(None, (device.note,))):
        show(Warn(message=sentence))
    if region is not None and model.origin is not None:
        region[:3, 3] -= model.origin
    mode, masks = _masks(dataset)
    if args.between and mode != "none":
        show(Warn(message="Views between photos have no masks, so `--between` changes nothing."))
    mesh = make_mesh(
        model.splats,
        cameras,
        request,
        masks=masks,
        mask_mode=mode,
        photos=None if dataset is None else partial(_photo, dataset, model),
        origin=model.origin,
        report=_report(show),
        on_plan=lambda facts: show(MeshPlanned(**facts)),
        cancelled=lambda: control.stopping,
        threads=args.threads,
        near=model.near,
        antialias=model.antialias,
        device=device,
    )
    if control.stopping:
        raise Cancelled(_STOPPED)
    show(MeshProgress(phase="writing", done=0, total=0))
    up = stated_up(model.file.comments) or up_axis(cameras)
    write_surface(output, replace(mesh, up=up))
    return _result(output, model, mesh, mode, show)


def _result(
    output: Path, model: ModelArgument, mesh: SurfaceMesh, mode: str, show: Show
) -> dict[str, Any]:
    figures = {"vertices": len(mesh.vertices), "triangles": len(mesh.triangles)}
    show(MeshDone(path=str(output), **figures, voxel=mesh.facts["voxel"]))
    covered = mesh.facts["covered"]
    if covered is not None and covered < _FEW:
        show(Warn(message=_gaps_text(covered, mesh.facts["far"], mesh.facts["voxel"])))
    low, high = mesh.in_capture.min(axis=0), mesh.in_capture.max(axis=0)
    return {
        "path": str(output),
        "model": str(model.path),
        **figures,
        **mesh.facts,
        "mask_mode": mode,
        "low": low.tolist(),
        "high": high.tolist(),
    }


def _gaps_text(covered: float, far: float, voxel: float) -> str:
    return (
        f"The mesh covers only {covered:.0%} of the surfaces in the training views. `--far "
        f"{4 * far:.3g}` and `--voxel {4 * voxel:.3g}` add more distant ones, coarser, and "
        "`--min-part 0` small parts; a training with `--surface-weight 1` makes depths reliable. "
        "Walls without texture and sky stay ragged: cut them off by `--box` or masks."
    )


def _region(args: argparse.Namespace) -> np.ndarray | None:
    """[4, 4] float64, the given box in the world of the capture; None: there is none."""
    if args.region is not None:
        return read_region(args.region)
    if args.box is None:
        return None
    low, high = np.array(args.box, np.float64).reshape(2, 3)
    if not (np.isfinite(args.box).all() and (low < high).all()):
        raise ConfigError(
            "`--box` needs its lower corner first, then its upper one, such as -1 -1 -1 1 1 1, got "
            f"{' '.join(f'{value:g}' for value in args.box)}."
        )
    return box_of_corners(low, high)


def _cameras(
    args: argparse.Namespace, model: ModelArgument, show: Show
) -> tuple[Cameras, Dataset | None]:
    """The training cameras in the world of the splats, and the capture with its masks; None:
    without. Held-out photos are not used, so that a mesh can be measured with them."""
    file = args.source is not None and not args.source.is_dir()
    lost = args.source is None and not (model.data and model.data.source.exists())
    if file or lost:
        if lost and model.data and model.data.mask_mode != "none":
            message = f"The capture {model.data.source} no longer exists, so masks are not used."
            show(Warn(message=message))
        found = captured_cameras(args.source, model)
        train = [i for i in range(len(found.cameras)) if i not in set(found.test)]
        return found.cameras.subset(train), None
    dataset = load_dataset(data_config_of(args, model))
    dataset.limit_cache()
    for sentence in dataset.warnings:
        show(Warn(message=sentence))
    return model.world_of(dataset.scene.cameras.subset(dataset.train)), dataset


def _masks(dataset: Dataset | None) -> tuple[str, Callable[[int], np.ndarray | None]]:
    if dataset is None or dataset.mask_mode == "none":
        return "none", lambda index: None
    return dataset.mask_mode, lambda index: dataset.mask(dataset.train[index])


def _photo(dataset: Dataset, model: ModelArgument, index: int) -> Photo:
    """A training photo in the mean exposure of the training, and its mask."""
    index = dataset.train[index]
    exposure = model.exposures.get(dataset.names[index], NEUTRAL)
    rgb = exposure.undo(dataset.image(index).astype(np.float32) / np.float32(255))
    return rgb, dataset.mask(index)


def _report(show: Show) -> Callable[[str, int, int, float], None]:
    return lambda phase, done, total, eta: show(
        MeshProgress(phase=phase, done=done, total=total, eta_s=eta)
    )


def mesh_text(result: dict[str, Any]) -> str:
    """The result as a line of text."""
    vertices = count_text(result["vertices"], "vertex", "vertices")
    triangles = count_text(result["triangles"], "triangle")
    covered = result["covered"]
    share = "" if covered is None else f"; {covered:.0%} of the surfaces in the training views"
    return (
        f"{result['path']}: {vertices}, {triangles} from {count_text(result['views'], 'view')}; "
        f"voxels of {result['voxel']:.3g} world units{share}"
    )

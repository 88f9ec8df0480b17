"""Loading of a capture folder into a Dataset: layout, sizes, masks, points and split."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..config import DataConfig
from ..errors import Cancelled
from ..io.images.read_image import read_info
from ..scene import Cameras, PointCloud, Scene, within_reach
from ..text_format import count_text
from .capture import View
from .dataset import Dataset
from .decode import ViewFile, decode_view
from .masks import MaskChoice, choose_masks
from .photo_headers import PhotoFit, check_fit, fit_photos, photo_warnings, up_from_exif
from .points import RANDOM_POINTS, colors_from_photos, point_warnings, random_points
from .read import read_capture
from .resolution import (
    check_resolution,
    scale_intrinsics,
    small_width_warnings,
    target_size,
)
from .shots import warn_of_split_shots
from .split import is_chosen, split_views, split_warnings
from .undistort import Undistortion, plan_undistortion

RANDOM_SEED = 0
"""Seed of the random points."""


def load_dataset(
    config: DataConfig,
    *,
    origin: np.ndarray | None = None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Dataset:
    """Read a capture: a COLMAP model or a transforms.json, with photos and masks.

    Photos are not decoded yet (except to colour black points): `Dataset.nbytes` is the memory they
    need, `Dataset.preload` decodes them.

    Args:
        config: Capture and options.
        origin: [3], local origin for cameras and points, in the coordinates of the capture; zeros:
            none; None: chosen where float32 needs one.
        cancelled: Called between photos; True stops the call.

    Raises:
        Cancelled: `cancelled` returned True.
        DatasetError: data is missing, does not match, or leaves nothing to train on.
        FormatError: a file is truncated, corrupt or of an unknown format.
        ConfigError: an option has an invalid value.
        BackendError: an optional package that this capture needs is not installed.
    """
    check_resolution(config.resolution)
    capture = read_capture(config, origin=origin)
    views = sorted(capture.views, key=lambda view: view.name)
    infos = []
    for view in views:
        _go_on(cancelled)
        infos.append(read_info(view.image))
    fit = fit_photos(views, infos)
    check_fit(views, infos, fit)
    warnings = [*capture.warnings, *photo_warnings(views, infos, fit, cancelled)]
    masks = choose_masks(config, capture, views, infos, fit.sizes, cancelled=cancelled)
    warnings += masks.warnings
    files, Ks = _files(views, fit, masks, config)
    warnings += _cut_off(views, files)
    warnings += small_width_warnings(config.resolution, *files[0].size)
    narrow = sum(1 for file in files if file.photo_size[0] < config.resolution)
    if narrow:
        warnings.append(
            f"{count_text(narrow, 'photo is', 'photos are')} narrower than the "
            f"requested {config.resolution:g} px and used at full size."
        )
    cameras = Cameras(
        viewmats=np.stack([view.viewmat for view in views]),
        Ks=np.stack(Ks),
        widths=np.array([file.size[0] for file in files], np.int64),
        heights=np.array([file.size[1] for file in files], np.int64),
        names=tuple(view.name for view in views),
        up=up_from_exif(views, infos) if capture.up is None else capture.up,
        origin=capture.origin,
    )
    train, test = split_views(cameras.names, config, stated=capture.test_names)
    by_rule = is_chosen(config, stated=capture.test_names)
    train, test, shot_warnings = warn_of_split_shots(views, train, test, chosen=by_rule)
    warnings += shot_warnings
    warnings += split_warnings(len(views), test, config)
    points = _points(capture.points, cameras, views, files, warnings, cancelled)
    return Dataset(
        scene=Scene(cameras=cameras, points=points, warnings=tuple(warnings)),
        files=files,
        train=train,
        test=test,
        mask_mode=masks.mode,
        source=capture.root,
    )


def _go_on(cancelled: Callable[[], bool]) -> None:
    if cancelled():
        raise Cancelled("Reading the photos was stopped.")


def _cut_off(views: list[View], files: list[ViewFile]) -> list[str]:
    """Warning about photos that lose their rim because the distortion folds back there."""
    cut = [
        (file.plan.cut_off, view)
        for view, file in zip(views, files, strict=True)
        if file.plan is not None and file.plan.cut_off
    ]
    if not cut:
        return []
    most, worst = max(cut, key=lambda pair: pair[0])
    return [
        f"The distortion of {count_text(len(cut), 'photo')} folds back at the rim, so up to "
        f"{100 * most:.0f} % of them are left out ({worst.name}, {worst.camera.model} "
        f"{worst.camera.params.tolist()}). COLMAP with a simpler camera model may keep more."
    ]


def _files(
    views: list[View],
    fit: PhotoFit,
    masks: MaskChoice,
    config: DataConfig,
) -> tuple[list[ViewFile], list[np.ndarray]]:
    """Decoding settings of each view, and its K at the final size, [3, 3] float64 each."""
    plans: dict[tuple, Undistortion | None] = {}
    files, Ks = [], []
    for i, (view, size) in enumerate(zip(views, fit.sizes, strict=True)):
        camera = view.camera
        key = (camera.model, camera.width, camera.height, camera.params.tobytes())
        if key not in plans:
            plans[key] = plan_undistortion(camera)
        plan = plans[key]
        if plan is None:
            K, own, full = camera.K, (camera.width, camera.height), size
        else:
            K, own = plan.K, (plan.width, plan.height)
            full = (
                max(1, round(plan.width * size[0] / camera.width)),
                max(1, round(plan.height * size[1] / camera.height)),
            )
        target = target_size(*full, config.resolution, max_width=config.max_width)
        Ks.append(scale_intrinsics(K, own, target))
        files.append(
            ViewFile(
                image=view.image,
                mask=masks.files[i],
                mask_inverted=config.invert_masks,
                use_alpha=masks.use_alpha[i],
                upright=fit.upright[i],
                photo_size=size,
                size=target,
                plan=plan,
            )
        )
    return files, Ks


def _points(
    points: PointCloud,
    cameras: Cameras,
    views: list[View],
    files: list[ViewFile],
    warnings: list[str],
    cancelled: Callable[[], bool],
) -> PointCloud:
    """The capture's points within reach and coloured; random points if none is usable."""
    usable = within_reach(points.points)
    warnings += point_warnings(points, usable)
    if not usable.any():
        return random_points(cameras, RANDOM_POINTS, seed=RANDOM_SEED)
    observed: list[np.ndarray | None] = [view.observed for view in views]
    if not usable.all():
        new_index = np.cumsum(usable) - 1
        for i, index in enumerate(observed):
            if index is not None:
                observed[i] = new_index[index[usable[index]]]
        points = PointCloud(points=points.points[usable], colors=points.colors[usable])
    if points.colors.any():
        return points

    # Not kept: the caller decides by `nbytes` whether all photos fit in memory.
    def load(i: int) -> tuple[np.ndarray, np.ndarray | None]:
        _go_on(cancelled)
        return decode_view(files[i])

    colors = colors_from_photos(points.points, cameras, observed, load)
    return replace(points, colors=colors)

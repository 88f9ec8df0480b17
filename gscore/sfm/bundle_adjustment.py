"""Final bundle adjustment; the focal length is freed, or fixed where photos do not constrain it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .pycolmap_thread import colmap

HIGH_ERROR = 1.0
"""Mean reprojection error, px, above which the lens model is doubted."""
_SHARP = 2.0
"""Reprojection error, px, above which an observation is left out of the last adjustment."""
_LEAST_ANGLE = 1.5
"""Degrees between the rays of a point."""
_OTHER = 1.25
"""Another focal length, against the one found, with which the photos are tried."""
_NEARLY = 1.15
"""Mean error with the other focal length, against that found, up to which photos do not tell it.
Measured: 1.02 for a walk straight ahead (lund), 2.4 for walks around something (studio)."""
_TRIAL_STEPS = 40
"""Steps of the adjustment with the other focal length, at most; a walk ahead needs 14."""


LEAST_SEEN = 15
"""Points that a photo of a model sees in the mean, without which nothing holds its camera; as many
matches as COLMAP asks of a pair."""
_ROUGH = 4.0
"""Reprojection error, px, of a model that was not adjusted; COLMAP's own."""


@dataclass(frozen=True)
class AdjustedLens:
    """What became of the lens."""

    before: float | None
    """Mean error, px, before the lens was given two focal lengths and more coefficients; None: it
    was not."""
    after: float
    """Mean error of what is left in."""
    held: bool
    """The photos do not tell the focal length, and it is the one that was expected."""


def adjust(model: Any, *, may_free: bool, expected: Mapping[int, float]) -> AdjustedLens:
    """Leave out what does not fit well, and adjust cameras and points of pycolmap's Reconstruction
    to the rest, with a loss (soft L1) that single wrong points cannot pull.

    Args:
        model: Changed in place.
        may_free: Give the lenses two focal lengths and more coefficients (OPENCV) where the error
            is above `HIGH_ERROR`: photos that were scaled by other factors across than down need
            two, and one of them bends the whole model.
        expected: Focal lengths in px by camera that are kept where the photos fit as well with one
            as with another: where the camera only moves ahead, a longer lens and a longer way look
            alike. How the lens bends is still found: with a focal length that is off, no bend at
            all fits the photos worse (lund: 0.464 px instead of 0.459, and drafts lose 0.2 dB).
    """
    before = _error(model)
    freed = may_free and before > HIGH_ERROR
    if freed:
        for camera in model.cameras.values():
            f, cx, cy, k = camera.params
            camera.model = colmap().CameraModelId.OPENCV
            camera.params = [f, f, cx, cy, k, 0.0, 0.0, 0.0]
        _solve(model)
    _leave_out(model)
    _solve(model)
    held = not freed and _hold_untold(model, expected)
    return AdjustedLens(before if freed else None, _error(model), held)


def is_stable(model: Any) -> bool:
    """Whether the points of pycolmap's Reconstruction are enough to hold its cameras."""
    return model.compute_num_observations() >= LEAST_SEEN * model.num_reg_images()


def may_be_stable(model: Any) -> bool:
    """Whether a model that was not adjusted has enough points with parallax: one of a camera that
    turned on the spot has points anywhere on their rays."""
    trial = colmap().Reconstruction(model)
    colmap().ObservationManager(trial).filter_all_points3D(_ROUGH, _LEAST_ANGLE)
    return is_stable(trial)


def _hold_untold(model: Any, expected: Mapping[int, float]) -> bool:
    """Give the cameras the expected focal lengths where the photos do not tell them."""
    most = _NEARLY * _error(model)
    trial = colmap().Reconstruction(model)
    for camera in trial.cameras.values():
        _set_focal(camera, _OTHER * camera.mean_focal_length())
    _solve(trial, focal=False, bend=False, steps=_TRIAL_STEPS)
    if not _error(trial) < most:
        return False
    usual = colmap().Reconstruction(model)
    _expect(usual, expected)
    _solve(usual, focal=False, bend=False)
    if not _error(usual) < most:
        return False
    _expect(model, expected)
    _solve(model, focal=False)
    _leave_out(model)
    _solve(model, focal=False)
    return True


def _expect(model: Any, expected: Mapping[int, float]) -> None:
    for number, camera in model.cameras.items():
        _set_focal(camera, expected[number])
        params = camera.params
        params[list(camera.extra_params_idxs())] = 0.0
        camera.params = params


def _set_focal(camera: Any, focal: float) -> None:
    """Two focal lengths keep their ratio."""
    params, where = camera.params, list(camera.focal_length_idxs())
    params[where] *= focal / camera.mean_focal_length()
    camera.params = params


def _leave_out(model: Any) -> None:
    colmap().ObservationManager(model).filter_all_points3D(_SHARP, _LEAST_ANGLE)


def _error(model: Any) -> float:
    model.update_point_3d_errors()
    return model.compute_mean_reprojection_error()


def _solve(model: Any, *, focal: bool = True, bend: bool = True, steps: int = 0) -> None:
    """Bundle adjustment.

    Args:
        model: Changed in place.
        focal: Focal lengths too.
        bend: Coefficients of distortion too.
        steps: At most; 0: as many as COLMAP takes.
    """
    p = colmap()
    options = p.BundleAdjustmentOptions(print_summary=False)
    options.ceres.loss_function_type = p.LossFunctionType.SOFT_L1
    options.refine_focal_length, options.refine_extra_params = focal, bend
    if steps:
        options.ceres.solver_options.max_num_iterations = steps
    # Not `bundle_adjustment`, which writes a heading whatever its log's level is.
    config = p.BundleAdjustmentConfig()
    for number in model.reg_image_ids():
        config.add_image(number)
    config.fix_gauge(p.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    p.create_default_bundle_adjuster(options, config, model).solve()

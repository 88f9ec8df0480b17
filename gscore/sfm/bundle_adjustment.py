"""Final bundle adjustment; the focal length is freed, or fixed where photos do not constrain it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .pycolmap_thread import colmap

HIGH_ERROR = 1.0
"""Mean reprojection error, px, above which a lens model with more coefficients is tried."""
_SHARP = 2.0
"""Reprojection error, px, above which the last adjustment leaves an observation out."""
_LEAST_ANGLE = 1.5
"""Minimum triangulation angle of a point, degrees."""
_OTHER = 1.25
"""Factor on the focal length in the trial of whether the photos constrain it."""
_NEARLY = 1.15
"""Ratio of the mean errors, trial to found, up to which the photos do not constrain the focal
length. Measured: 1.02 for a walk straight ahead (lund), 2.4 for walks around an object (studio)."""
_TRIAL_STEPS = 40
"""Maximum number of solver steps of the trial; a walk ahead needs 14."""


LEAST_SEEN = 15
"""Minimum mean number of observations per photo for stable camera poses; equal to COLMAP's minimum
number of matches of a pair."""
_ROUGH = 4.0
"""Maximum reprojection error, px, before the adjustment; COLMAP's own."""


@dataclass(frozen=True)
class AdjustedLens:
    """Lens model after the adjustment."""

    before: float | None
    """Mean error, px, before the change to OPENCV, with two focal lengths and more coefficients;
    None: no change."""
    after: float
    """Mean error, px, of the observations that are left."""
    fixed: bool
    """The photos do not constrain the focal length, so the expected one was set."""


def adjust(model: Any, *, may_free: bool, expected: Mapping[int, float]) -> AdjustedLens:
    """Remove outliers from a pycolmap Reconstruction and adjust its cameras and points, with a soft
    L1 loss, which limits the influence of single wrong points.

    Args:
        model: Changed in place.
        may_free: Give the lenses two focal lengths and more coefficients (OPENCV) where the error
            is above `HIGH_ERROR`: photos scaled by different factors in x and y need two, and one
            such photo distorts the whole model.
        expected: Focal lengths in px by camera id, set where the photos do not constrain them: if
            the camera only moves ahead, a longer lens and a longer path give the same pictures. The
            distortion is still estimated: with a wrong focal length, no distortion fits the photos
            worse (lund: 0.464 px instead of 0.459, and drafts lose 0.2 dB).
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
    fixed = not freed and _fix_unconstrained(model, expected)
    return AdjustedLens(before if freed else None, _error(model), fixed)


def is_stable(model: Any) -> bool:
    """Whether a pycolmap Reconstruction has enough observations for stable camera poses."""
    return model.compute_num_observations() >= LEAST_SEEN * model.num_reg_images()


def may_be_stable(model: Any) -> bool:
    """Whether a model has enough points with parallax before the adjustment: if the camera turned
    on the spot, its points are anywhere on their rays."""
    trial = colmap().Reconstruction(model)
    colmap().ObservationManager(trial).filter_all_points3D(_ROUGH, _LEAST_ANGLE)
    return is_stable(trial)


def _fix_unconstrained(model: Any, expected: Mapping[int, float]) -> bool:
    """Set the expected focal lengths if the photos do not constrain them; True if set."""
    most = _NEARLY * _error(model)
    trial = colmap().Reconstruction(model)
    for camera in trial.cameras.values():
        _set_focal(camera, _OTHER * camera.mean_focal_length())
    _solve(trial, focal=False, distortion=False, steps=_TRIAL_STEPS)
    if not _error(trial) < most:
        return False
    typical = colmap().Reconstruction(model)
    _expect(typical, expected)
    _solve(typical, focal=False, distortion=False)
    if not _error(typical) < most:
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
    """Set the mean focal length; two focal lengths keep their ratio."""
    params, where = camera.params, list(camera.focal_length_idxs())
    params[where] *= focal / camera.mean_focal_length()
    camera.params = params


def _leave_out(model: Any) -> None:
    colmap().ObservationManager(model).filter_all_points3D(_SHARP, _LEAST_ANGLE)


def _error(model: Any) -> float:
    model.update_point_3d_errors()
    return model.compute_mean_reprojection_error()


def _solve(model: Any, *, focal: bool = True, distortion: bool = True, steps: int = 0) -> None:
    """Run COLMAP's bundle adjustment.

    Args:
        model: Changed in place.
        focal: Refine focal lengths.
        distortion: Refine distortion coefficients.
        steps: Maximum number; 0: COLMAP's default.
    """
    p = colmap()
    options = p.BundleAdjustmentOptions(print_summary=False)
    options.ceres.loss_function_type = p.LossFunctionType.SOFT_L1
    options.refine_focal_length, options.refine_extra_params = focal, distortion
    if steps:
        options.ceres.solver_options.max_num_iterations = steps
    # Not `bundle_adjustment`, which logs a heading at every log level.
    config = p.BundleAdjustmentConfig()
    for number in model.reg_image_ids():
        config.add_image(number)
    config.fix_gauge(p.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    p.create_default_bundle_adjuster(options, config, model).solve()

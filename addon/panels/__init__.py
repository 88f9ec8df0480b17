"""Panels of the sidebar tab "Train Splats", in the order of the work."""

from . import (
    cameras,
    capture,
    depth,
    edit,
    error_maps,
    progress,
    region_training,
    render,
    result,
    running_work,
    sequence,
    train,
    train_sequence,
)

CLASSES = (
    *capture.CLASSES,
    *cameras.CLASSES,
    *depth.CLASSES,
    *train.CLASSES,
    *train_sequence.CLASSES,
    *running_work.CLASSES,
    *progress.CLASSES,
    *result.CLASSES,
    *error_maps.CLASSES,
    *sequence.CLASSES,
    *edit.CLASSES,
    *region_training.CLASSES,
    *render.CLASSES,
)

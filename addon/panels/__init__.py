"""The tab "Train Splats" of the 3D view's sidebar, in the order of the work."""

from . import (
    cameras,
    capture,
    depth,
    edit,
    judge,
    now,
    paint,
    progress,
    render,
    result,
    sequence,
    steer,
    train,
    train_sequence,
)

CLASSES = (
    *capture.CLASSES,
    *cameras.CLASSES,
    *depth.CLASSES,
    *train.CLASSES,
    *train_sequence.CLASSES,
    *now.CLASSES,
    *progress.CLASSES,
    *result.CLASSES,
    *judge.CLASSES,
    *sequence.CLASSES,
    *edit.CLASSES,
    *paint.CLASSES,
    *steer.CLASSES,
    *render.CLASSES,
)

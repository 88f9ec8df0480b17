"""The tab "Train Splats" of the 3D view's sidebar, in the order of the work."""

from . import cameras, capture, depth, edit, progress, render, result, sequence, train

CLASSES = (
    *capture.CLASSES,
    *cameras.CLASSES,
    *depth.CLASSES,
    *train.CLASSES,
    *progress.CLASSES,
    *result.CLASSES,
    *sequence.CLASSES,
    *edit.CLASSES,
    *render.CLASSES,
)

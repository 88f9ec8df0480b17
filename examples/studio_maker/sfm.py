"""Structure from motion of the rendered pictures, aligned to the true camera positions."""

import tempfile
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pycolmap

from gscore.io.colmap.folder import read_model, write_model

MIN_TRACK = 4
"""Points observed in fewer pictures are removed."""
MAX_ERROR_PX = 1.5
"""Points with a larger mean reprojection error are removed."""


def reconstruct(images, target, names, centers):
    """Run COLMAP on a folder of pictures and write a binary model.

    Args:
        images: folder of the pictures.
        target: folder for cameras.bin, images.bin, points3D.bin.
        names: file names of the pictures.
        centers: [C, 3] true positions of their cameras in metres.

    Returns:
        Statistics of the model.
    """
    pycolmap.set_random_seed(0)
    with tempfile.TemporaryDirectory() as work:
        work = Path(work)
        database = work / "database.db"
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = "PINHOLE"
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.sift.max_num_features = 3000
        pycolmap.extract_features(
            database, images, image_names=names, camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader, extraction_options=extraction, device=pycolmap.Device.cpu,
        )  # fmt: skip
        pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
        mapping = pycolmap.IncrementalPipelineOptions()
        mapping.random_seed, mapping.num_threads = 0, 1  # the same model every time
        models = pycolmap.incremental_mapping(database, images, work, mapping)
        model = max(models.values(), key=lambda m: m.num_reg_images())
        if model.num_reg_images() < len(names):
            raise RuntimeError(
                f"COLMAP registered {model.num_reg_images()} of {len(names)} pictures; all are "
                "required."
            )
        error = align(model, dict(zip(names, centers, strict=True)))
        model.update_point_3d_errors()
        part = work / "model"
        part.mkdir()
        model.write_binary(part)
        bundled = slim(read_model(part))
        write_model(bundled, target)
    points = bundled.points
    return {
        "registered": model.num_reg_images(),
        "points": len(points.ids),
        "mean_track_length": round(float(points.track_lengths.mean()), 3),
        "mean_reprojection_error_px": round(float(points.error.mean()), 4),
        "median_camera_error_m": round(float(np.median(error)), 6),
        "params": [round(float(x), 4) for x in next(iter(model.cameras.values())).params],
    }


def align(model, centers):
    """Align a model to the true positions; returns the errors [C] of its cameras in metres."""
    images = list(model.images.values())
    found = np.array([i.projection_center() for i in images])
    true = np.array([centers[i.name] for i in images])
    scale, rotation, shift = similarity(found, true)
    model.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d(rotation), shift))
    return np.linalg.norm([i.projection_center() for i in images] - true, axis=1)


def similarity(source, target):
    """Scale s, rotation R, shift t of target = s R source + t, least squares (Umeyama 1991)."""
    a, b = source - source.mean(0), target - target.mean(0)
    u, d, vt = np.linalg.svd(b.T @ a)
    flip = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ flip @ vt
    scale = np.trace(np.diag(d) @ flip) / np.sum(a**2)
    return scale, rotation, target.mean(0) - scale * rotation @ source.mean(0)


def slim(model):
    """The model without inaccurate points and without features that have no point.

    The features are most of the file.
    """
    points = model.points
    good = (points.track_lengths >= MIN_TRACK) & (points.error <= MAX_ERROR_PX)
    kept = points.ids[good]
    images = []
    for image in model.images:
        seen = np.isin(image.point3D_ids, kept)
        images.append(replace(image, xys=image.xys[seen], point3D_ids=image.point3D_ids[seen]))
    rows = {f.name: getattr(points, f.name)[good] for f in fields(points)}
    return replace(model, images=images, points=replace(points, **rows))

"""Make a short multi-view video of the twisting studio figure, as input for `gscore sequence`.

    gscore train examples/studio -o out/base -r 240 --mask-mode none
    python examples/make_sequence.py out/base/point_cloud.ply -o out/turning --frames 6

The splats of the figure are rotated around the vertical axis, by larger angles at larger heights,
and rendered from the cameras of the capture. The folder layout is that of PKU-DyMVHumans
(`data_COLMAP/<frame>`): every frame has its own COLMAP world frame and focal length. Errors of the
camera poses and focal lengths are simulated.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import gscore
from gscore.frontend import (
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    read_colmap,
    rotmat_to_quat,
    write_colmap,
)
from gscore.io.images.png import write_png

STUDIO = Path(__file__).parent / "studio"
FIGURE_RADIUS = 0.75
"""Radius in metres around the vertical axis of the studio within which splats belong to the
figure."""
TURNED_FROM, TURNED_TO = 0.35, 1.3
"""Heights in metres between which the rotation increases from 0 to its maximum."""
DEGREES_A_FRAME = 3.0
"""Rotation per frame at and above the upper height; it moves the hand by 25 mm per frame."""
POSE_NOISE = 2e-4
"""Standard deviation of camera positions, metres."""
FOCAL_NOISE = 2e-4
"""Standard deviation of the focal length, relative."""


def main() -> int:
    """Write the frames."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("splats", type=Path, help="PLY of splats trained on the studio capture")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write")
    parser.add_argument("--frames", type=int, default=6, help="number of frames")
    parser.add_argument("--width", type=int, default=240, help="width of the photos in pixels")
    parser.add_argument("--views", type=int, default=60, help="number of cameras to use")
    args = parser.parse_args()
    splats, model = gscore.read_splats(args.splats), read_colmap(STUDIO)
    model = replace(model, images=model.images[: args.views])
    for frame in range(args.frames):
        folder = args.output / "data_COLMAP" / f"{frame:06d}"
        angle = np.deg2rad(DEGREES_A_FRAME) * frame
        write_photos(folder, turn(splats, angle), model, args.width, frame)
        write_colmap(recovered(model, angle, args.width, frame), folder / "sparse")
        print(folder)
    return 0


def weights(points: np.ndarray) -> np.ndarray:
    """[N] share of the full rotation that applies to points [N, 3]."""
    height = (points[:, 2] - TURNED_FROM) / (TURNED_TO - TURNED_FROM)
    share = np.clip(height, 0, 1)
    inside = np.hypot(points[:, 0], points[:, 1]) < FIGURE_RADIUS
    return share * share * (3 - 2 * share) * inside


def turn_points(points: np.ndarray, angle: float) -> np.ndarray:
    """Points [N, 3] float64, rotated by `angle` radians times their weights."""
    part = angle * weights(points)
    c, s = np.cos(part), np.sin(part)
    x, y, z = points.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)


def turn(splats: gscore.Splats, angle: float) -> gscore.Splats:
    """Rotated splats; the view-dependent colour is not rotated, because the light stays fixed."""
    means = splats.means.astype(np.float64)
    half = 0.5 * angle * weights(means)
    w, x, y, z = splats.quats.astype(np.float64).T
    c, s = np.cos(half), np.sin(half)
    quats = np.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], axis=1)
    return replace(
        splats,
        means=turn_points(means, angle).astype(np.float32),
        quats=quats.astype(np.float32),
    )


def write_photos(
    folder: Path, splats: gscore.Splats, model: ColmapModel, width: int, frame: int
) -> None:
    """Render the photos of a frame from the cameras of the capture."""
    for number, image in enumerate(model.images):
        camera = model.cameras[image.camera_id]
        K = np.diag([width / camera.width, width / camera.width, 1]) @ camera.K
        height = round(camera.height * width / camera.width)
        view = gscore.render(splats, K, image.viewmat, width, height)
        photo = (np.clip(view.rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
        write_png(folder / "images" / photo_name(number, frame), photo)


def photo_name(number: int, frame: int) -> str:
    """File name of a photo, as in PKU-DyMVHumans."""
    return f"image_c_{number:03d}_f_{frame:06d}.png"


def recovered(model: ColmapModel, angle: float, width: int, frame: int) -> ColmapModel:
    """Simulated structure from motion: another world frame, and cameras with small errors."""
    rng = np.random.default_rng(frame)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.linalg.det(rotation)
    scale, shift = rng.uniform(0.5, 2), rng.normal(size=3)
    focal = 1 + FOCAL_NOISE * rng.normal()
    images = []
    for number, image in enumerate(model.images):
        viewmat = image.viewmat
        place = -viewmat[:3, :3].T @ viewmat[:3, 3] + POSE_NOISE * rng.normal(size=3)
        turned = viewmat[:3, :3] @ rotation.T
        images.append(
            ColmapImage(
                id=number + 1,
                name=photo_name(number, frame),
                camera_id=image.camera_id,
                qvec=rotmat_to_quat(turned),
                tvec=-turned @ (scale * rotation @ place + shift),
                xys=np.zeros((0, 2)),
                point3D_ids=np.zeros(0, np.int64),
            )
        )
    points = turn_points(model.points.xyz, angle)
    return ColmapModel(
        cameras={key: scaled(camera, width, focal) for key, camera in model.cameras.items()},
        images=images,
        points=replace(model.points, xyz=scale * points @ rotation.T + shift),
    )


def scaled(camera: ColmapCamera, width: int, focal: float) -> ColmapCamera:
    """A PINHOLE camera at another image width, with its focal length times `focal`."""
    ratio = width / camera.width
    height = round(camera.height * ratio)
    params = camera.params * ratio * np.array([focal, focal, 1, 1])
    return ColmapCamera(model="PINHOLE", width=width, height=height, params=params)


if __name__ == "__main__":
    sys.exit(main())

"""Blocks compared to one training of a large capture: python tools/measure/blocks.py RUN -o FOLDER.

RUN is a finished run of a capture whose cameras go around a subject. The subject is cut out and
copied several times in a row; photos of all copies are rendered from the run's camera positions.
That capture is trained as a whole, and split, trained and merged; held-out photos measure both.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from gscore_line import verb
from PIL import Image

import gscore
from gscore.io.cameras_json import read_cameras_json
from gscore.io.colmap.folder import write_model
from gscore.io.colmap.model import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
from gscore.scene import Cameras
from gscore.sh import sh0_to_rgb
from gscore.splats import PARAMETERS, Splats
from gscore.transforms import rotmat_to_quat

JITTER = 0.05
"""Random offset of cameras from those of the run, as a share of the mean distance to the focus."""
POINTS = 8000
"""Points per copy in the capture."""
HIDDEN = 0.03
"""Depth difference up to which a point is visible, as a share of its distance."""


def focus(cameras: Cameras) -> np.ndarray:
    """[3] point nearest to all optical axes."""
    ahead, centers = cameras.viewmats[:, 2, :3], cameras.centers
    across = np.eye(3) - ahead[:, :, None] * ahead[:, None, :]
    return np.linalg.solve(across.sum(0), np.einsum("cij,cj->i", across, centers))


def along_the_ground(cameras: Cameras) -> np.ndarray:
    """[2, 3] two perpendicular directions with the largest spread of cameras."""
    centers = cameras.centers - cameras.centers.mean(0)
    return np.linalg.svd(centers, full_matrices=False)[2][:2]


def street(splats: Splats, cameras: Cameras, copies: int) -> tuple[Splats, np.ndarray]:
    """Copies of the subject side by side, and the translation of each, [C, 3]."""
    middle, axes = focus(cameras), along_the_ground(cameras)
    reach = 0.8 * np.median(np.linalg.norm(cameras.centers - middle, axis=1))
    inside = (np.abs((splats.means - middle) @ axes.T) < reach).all(axis=1)
    inside &= np.linalg.norm(splats.means - middle, axis=1) < 2 * reach
    piece = {name: getattr(splats, name)[inside] for name in PARAMETERS}
    moves = 2 * reach * np.arange(copies)[:, None] * axes[0]
    parts = {name: np.concatenate([rows] * copies) for name, rows in piece.items()}
    parts["means"] = np.concatenate([piece["means"] + move for move in moves]).astype(np.float32)
    return Splats(**parts), moves


def viewpoints(cameras: Cameras, moves: np.ndarray, count: int, rng: np.random.Generator) -> Any:
    """`count` viewmats [4, 4] near cameras of the run, for each copy in turn."""
    distance = np.linalg.norm(cameras.centers - focus(cameras), axis=1).mean()
    found = []
    for k in range(count):
        viewmat = cameras.viewmats[(k // len(moves)) % len(cameras)].copy()
        shift = moves[k % len(moves)] + rng.normal(0, JITTER * distance, 3)
        viewmat[:3, 3] -= viewmat[:3, :3] @ shift
        found.append(viewmat)
    return found


def points_of(splats: Splats, count: int, rng: np.random.Generator) -> ColmapPoints:
    """Means of opaque splats as SfM points."""
    solid = np.flatnonzero(splats.opacities > 0)
    rows = rng.choice(solid, min(count, len(solid)), replace=False)
    return ColmapPoints(
        ids=np.arange(1, len(rows) + 1),
        xyz=splats.means[rows].astype(np.float64),
        rgb=(sh0_to_rgb(splats.sh0[rows, 0]).clip(0, 1) * 255).astype(np.uint8),
        error=np.ones(len(rows)),
        track_lengths=np.zeros(len(rows), np.int32),
    )


def visible_in(
    points: ColmapPoints, K: np.ndarray, viewmat: np.ndarray, depth: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pixel positions [M, 2] of unoccluded points in a picture with this depth; their ids [M]."""
    height, width = depth.shape
    places = points.xyz @ viewmat[:3, :3].T + viewmat[:3, 3]
    with np.errstate(all="ignore"):
        xys = (places @ K.T)[:, :2] / places[:, 2:]
    inside = (places[:, 2] > 0) & (xys >= 0).all(1) & (xys < (width, height)).all(1)
    column, row = np.where(inside[:, None], xys, 0).astype(int).T
    inside &= np.abs(places[:, 2] - depth[row, column]) < HIDDEN * places[:, 2]
    return xys[inside], points.ids[inside]


def write_capture(run: Path, folder: Path, *, photos: int, copies: int, width: int) -> None:
    """Render the photos and write them as a COLMAP capture."""
    rng = np.random.default_rng(0)
    cameras = read_cameras_json(run / "cameras.json")
    splats, moves = street(gscore.read_splats(run / "point_cloud.ply"), cameras, copies)
    points = points_of(splats, POINTS * copies, rng)
    scale = width / int(cameras.widths[0])
    height = round(int(cameras.heights[0]) * scale)
    K = cameras.Ks[0].copy()
    K[:2] *= scale
    K[:2, 2] = width / 2, height / 2
    (folder / "images").mkdir(parents=True)
    images = []
    for k, viewmat in enumerate(viewpoints(cameras, moves, photos, rng)):
        drawn = gscore.render(splats, K, viewmat, width, height)
        assert drawn.median_depth is not None
        name = f"{k % copies}_{k // copies:04d}.png"
        picture = (drawn.rgb.clip(0, 1) * 255 + 0.5).astype(np.uint8)
        Image.fromarray(picture).save(folder / "images" / name, compress_level=1)
        xys, ids = visible_in(points, K, viewmat, drawn.median_depth)
        images.append(
            ColmapImage(
                id=k + 1,
                name=name,
                camera_id=1,
                qvec=rotmat_to_quat(viewmat[:3, :3]),
                tvec=viewmat[:3, 3],
                xys=xys,
                point3D_ids=ids,
            )
        )
    lengths = np.bincount(np.concatenate([image.point3D_ids for image in images]))
    lengths = np.pad(lengths, (0, len(points) + 1 - len(lengths)))[points.ids]
    points = replace(points, track_lengths=lengths.astype(np.int32))
    pinhole = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]], np.float64)
    camera = ColmapCamera(model="PINHOLE", width=width, height=height, params=pinhole)
    (folder / "sparse" / "0").mkdir(parents=True)
    write_model(ColmapModel(cameras={1: camera}, images=images, points=points), folder / "sparse/0")


def print_row(name: str, found: dict[str, Any], steps: str, most: float, whole: float) -> None:
    """Print a row of the table."""
    cells = (
        *(name, steps, f"{found['splats']:,}", f"{found['psnr']:.2f}", f"{found['ssim']:.3f}"),
        *(f"{most / 1e6:,.0f}", f"{most / whole:.2f}"),
    )
    print(f"| {' | '.join(cells)} |", flush=True)


def main() -> int:
    """Write the capture, train it in both ways, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--photos", type=int, default=600)
    parser.add_argument("--blocks", type=int, default=4)
    parser.add_argument("--width", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=1500, help="steps per block")
    parser.add_argument("--splats", type=int, default=50_000, help="splats per block")
    parser.add_argument("--whole-steps", type=int, help="default: blocks times --steps")
    parser.add_argument("--whole-splats", type=int, help="default: blocks times --splats")
    parser.add_argument("--coarse", action="store_true", help="start blocks from a preview")
    parser.add_argument("--share", type=float, help="--share of `gscore split`")
    parser.add_argument("--margin", type=float, help="--margin of `gscore split`")
    args = parser.parse_args()
    capture, blocks = args.output / "capture", args.output / "blocks"
    write_capture(args.run, capture, photos=args.photos, copies=args.blocks, width=args.width)
    how = ("--preset", "preview", "-r", 1, "--checkpoint-seconds", 0)
    steps = args.whole_steps or args.blocks * args.steps
    cap = args.whole_splats or args.blocks * args.splats
    given = ("--iterations", steps, "--max-splats", cap, "--steps-a-photo", 0)
    whole = verb("train", capture, "-o", args.output / "whole", *how, *given, "--eval")
    cut = {"--share": args.share, "--margin": args.margin}
    cuts = [text for name, value in cut.items() if value is not None for text in (name, value)]
    verb("split", capture, "-o", blocks, "--blocks", args.blocks, *cuts)
    given = ("--iterations", args.steps, "--max-splats", args.splats, "--steps-a-photo", 0)
    if args.coarse:
        coarse = args.output / "coarse"
        verb("train", capture, "-o", coarse, "--preset", "preview", "--checkpoint-seconds", 0)
        given += ("--start-splats", coarse / "point_cloud.ply")
    parts = [
        verb("train", blocks, "-o", args.output / "runs", *how, *given, "--block", k, "--eval")
        for k in range(args.blocks)
    ]
    verb("merge", args.output / "runs", "-o", args.output / "merged.ply")
    merged = verb(
        *("eval", args.output / "merged.ply", "-s", capture, "-r", 1, "--hold-out", 8),
        *("-o", args.output / "measured"),
    )
    print("| | steps | splats | PSNR | SSIM | peak MB | relative MB |\n" + 7 * "|---" + "|")
    peak = whole["peak_memory_bytes"]
    print_row("whole", whole, f"{steps:,}", peak, peak)
    most = max(part["peak_memory_bytes"] for part in parts)
    print_row("merged", merged, f"{args.blocks} x {args.steps:,}", most, peak)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Camera comparison: cameras of `gscore sfm` compared to the given COLMAP model of captures.

    python tools/measure/compare_cameras.py examples/studio $GSCORE_DATA/data/lund

Prints a row of the table in docs/sfm.md for each capture: photos with a camera, attempts, points,
error, positions, focal lengths, wall-clock and CPU seconds. With --preset also the gain in PSNR of
held-out views from these cameras, median and mean over the views of all --seeds and --offsets (an
offset selects the held-out view of every 8).
"""

import argparse
import itertools
import resource
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from gscore.io.colmap.folder import ColmapModel, read_model
from gscore.presets import RECIPES
from gscore.sfm import SearchRequest, find_cameras
from gscore.sfm.search_request import MAPPERS
from gscore.trainer.run import train


def centers(model: ColmapModel) -> dict[str, np.ndarray]:
    """Positions of the cameras, [3] float64, by photo name."""
    return {i.name: -i.viewmat[:3, :3].T @ i.viewmat[:3, 3] for i in model.images}


def distances(found: np.ndarray, given: np.ndarray) -> np.ndarray:
    """[n] distances after the best similarity (Umeyama 1991), as shares of the given extent.

    Args:
        found: [n, 3] positions.
        given: [n, 3] positions of the same cameras.
    """
    a, b = given - given.mean(0), found - found.mean(0)
    u, s, vt = np.linalg.svd(a.T @ b)
    flip = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    fitted = b @ (u * flip @ vt).T * (s * flip).sum() / (b**2).sum()
    return np.linalg.norm(a - fitted, axis=1) / np.linalg.norm(a, axis=1).max()


def psnr_by_view(capture: Path, preset: str, seed: int, offset: int) -> dict[str, float]:
    """PSNR of the held-out views after a training, dB, by name."""
    data, config = RECIPES[preset](capture)
    # SfM copies no masks, so neither training may use masks.
    data = replace(data, eval=True, test_offset=offset, mask_mode="none")
    with tempfile.TemporaryDirectory() as folder:
        found = train(replace(config, seed=seed), data, Path(folder) / "run")
    return {view["name"]: view["psnr"] for view in found.metrics["views"]}


def gains(found: Path, given: Path, args: argparse.Namespace) -> str:
    """Gain in PSNR from the found cameras, as the last cell of a row."""
    off = []
    for seed, offset in itertools.product(range(args.seeds), args.offsets):
        mine, theirs = (
            psnr_by_view(capture, args.preset, seed, offset) for capture in (found, given)
        )
        off += [mine[name] - theirs[name] for name in mine.keys() & theirs.keys()]
    return f" {np.median(off):+.2f}, {np.mean(off):+.2f} dB |"


def cpu_seconds() -> float:
    """CPU time of this process on all cores."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Find the cameras and print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("--mapper", choices=MAPPERS, default="auto")
    parser.add_argument("--preset", choices=tuple(RECIPES))
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--offsets", type=int, nargs="+", default=[0])
    args = parser.parse_args()
    for source in args.captures:
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder) / "capture"
            request = SearchRequest(photos=source / "images", output=output, use_masks=False,
                              mapper=args.mapper)  # fmt: skip
            before = cpu_seconds()
            found = find_cameras(request)
            used = cpu_seconds() - before
            there, given = centers(read_model(output)), read_model(source)
            worth = gains(output, source, args) if args.preset else ""
        true = centers(given)
        names = sorted(there.keys() & true.keys())
        off = distances(*(np.array([part[name] for name in names]) for part in (there, true)))
        focal = ", ".join(str(round(camera["focal_px"])) for camera in found.cameras)
        print(
            f"| {source.name} | {found.registered} of {found.photos} ({len(true)}) | "
            f"{found.attempts} | {found.points} ({len(given.points)}) | "
            f"{found.reprojection_px:.3f} ({given.points.error.mean():.3f}) | "
            f"{np.median(off):.2%}, {off.max():.2%} | "
            f"{focal} | "
            f"{found.seconds:.0f}, {used:.0f} |{worth}",
            flush=True,
        )


if __name__ == "__main__":
    main()

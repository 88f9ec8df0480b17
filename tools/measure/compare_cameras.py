"""Find the cameras of captures from their photos alone and compare them with the given model.

    python tools/measure/compare_cameras.py examples/studio $GSCORE_DATA/data/lund

Prints a row of the table in docs/sfm.md for each capture.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from gscore.io.colmap import ColmapModel, read_model
from gscore.sfm import Request, find_cameras
from gscore.sfm.request import MAPPERS


def centers(model: ColmapModel) -> dict[str, np.ndarray]:
    """Places of the cameras, [3] float64 by the names of their photos."""
    return {i.name: -i.viewmat[:3, :3].T @ i.viewmat[:3, 3] for i in model.images}


def distances(found: np.ndarray, given: np.ndarray) -> np.ndarray:
    """After the best similarity (Umeyama 1991), as shares of the given cameras' extent.

    Args:
        found: [n, 3] places.
        given: [n, 3] places of the same cameras.
    """
    a, b = given - given.mean(0), found - found.mean(0)
    u, s, vt = np.linalg.svd(a.T @ b)
    flip = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    fitted = b @ (u * flip @ vt).T * (s * flip).sum() / (b**2).sum()
    return np.linalg.norm(a - fitted, axis=1) / np.linalg.norm(a, axis=1).max()


def main() -> None:
    """Search and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("--mapper", choices=MAPPERS, default="auto")
    args = parser.parse_args()
    for source in args.captures:
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder) / "capture"
            request = Request(photos=source / "images", output=output, use_masks=False,
                              mapper=args.mapper)  # fmt: skip
            found = find_cameras(request)
            there, given = centers(read_model(output)), read_model(source)
        true = centers(given)
        names = sorted(there.keys() & true.keys())
        off = distances(*(np.array([part[name] for name in names]) for part in (there, true)))
        print(
            f"| {source.name} | {found.registered} of {found.photos} ({len(true)}) | "
            f"{found.attempts} | {found.points} ({len(given.points)}) | "
            f"{found.reprojection_px:.3f} ({given.points.error.mean():.3f}) | "
            f"{np.median(off):.2%}, {off.max():.2%} | {found.seconds:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()

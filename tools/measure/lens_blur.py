"""Lens blur: PSNR lost to interpolation: python tools/measure/lens_blur.py CAPTURE... -o FOLDER.

Runs bundle adjustment of the given COLMAP model of each capture, with its pinhole lens and with a
distorted one (OPENCV), and trains previews with the given model and both results. Where errors and
positions agree, the gain of held-out views with the distorted lens is due to the interpolation of
all photos. Prints the rows of the table in docs/sfm.md.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from gscore_line import verb

from gscore.sfm.bundle_adjustment import adjust


def adjusted(model: Path, *, distorted: bool) -> Any:
    """The model after bundle adjustment; its lens must be a pinhole."""
    found = pycolmap.Reconstruction(str(model))
    for camera in found.cameras.values() if distorted else ():
        fx, fy, cx, cy = camera.params
        camera.model = pycolmap.CameraModelId.OPENCV
        camera.params = [fx, fy, cx, cy, 0.0, 0.0, 0.0, 0.0]
    expected = {key: camera.mean_focal_length() for key, camera in found.cameras.items()}
    adjust(found, may_free=False, expected=expected)
    found.update_point_3d_errors()
    return found


def views_of(capture: Path, run: Path) -> np.ndarray:
    """[V, 2] colour-corrected PSNR and SSIM of the held-out views after a preview."""
    how = ("--preset", "preview", "--eval", "--checkpoint-seconds", 0, "--overwrite")
    verb("train", capture, "-o", run, *how)
    views = json.loads((run / "metrics.json").read_text())["views"]
    return np.array([[view["psnr_cc"], view["ssim"]] for view in views])


def main() -> int:
    """Adjust and train, and print a row for each lens."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    print("| capture | lens | error, px | dB | SSIM |\n|---|---|---|---|---|", flush=True)
    for capture in args.captures:
        given = views_of(capture, args.output / capture.name / "given")
        for name, distorted in (("pinhole", False), ("distorted", True)):
            place = args.output / capture.name / f"capture_{name}"
            (place / "sparse/0").mkdir(parents=True, exist_ok=True)
            if not (place / "images").exists():
                (place / "images").symlink_to((capture / "images").resolve())
            model = adjusted(capture / "sparse/0", distorted=distorted)
            model.write(str(place / "sparse/0"))
            gained = views_of(place, args.output / capture.name / name) - given
            error = model.compute_mean_reprojection_error()
            dB, ssim = np.median(gained[:, 0]), gained[:, 1].mean()
            print(
                f"| {capture.name} | {name} | {error:.3f} | {dB:+.2f} | {ssim:+.4f} |", flush=True
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Video of a trained run with hand-held camera motion, motion blur and unusable parts.

    python tools/measure/make_video.py RUN -o walk.mp4 --seconds 20

The camera orbits once, trembles, stops for a while and is shaken twice; some frames are repeated.
`walk.json` next to the video has the kind of every frame (`sharp`, `shaken`, `held`, `still`) and
its true camera (world to camera, OpenCV axes).
"""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import gscore
from gscore.commands.args.model_argument import open_model
from gscore.commands.pictures.camera_path import orbit_path
from gscore.commands.pictures.video import write_video

RATE = 30
STILL, SHAKEN, HELD = (0.30, 0.36), ((0.15, 0.19), (0.62, 0.65)), ((0.45, 0.46), (0.80, 0.82))
"""Parts of the video, as shares of its length."""
TREMBLE, SHAKE = 0.004, 0.06
"""Largest angles, radians."""
FINE = 24
"""Samples of an exposure while the camera is shaken; fewer give distinct pictures, not blur."""
EXPOSURE = 0.5
"""Exposure time, as a share of the time between two frames."""


def kinds(count: int) -> list[str]:
    """The kind of each frame."""

    def kind(share: float) -> str:
        if any(a <= share < b for a, b in SHAKEN):
            return "shaken"
        if any(a <= share < b for a, b in HELD):
            return "held"
        return "still" if STILL[0] <= share < STILL[1] else "sharp"

    return [kind(i / count) for i in range(count)]


def places(what: list[str], samples: int) -> np.ndarray:
    """[frames, samples] position along the path, 0 to 1, during each exposure."""
    speed = np.array([0.0 if kind == "still" else 1.0 for kind in what])
    speed = np.convolve(speed, np.ones(15) / 15, mode="same")
    way = np.concatenate([[0.0], np.cumsum(speed)])
    moments = np.arange(len(what))[:, None] + np.arange(samples) / samples * EXPOSURE
    return np.interp(moments, np.arange(len(way)), way) / way[-1]


def trembling(what: list[str], samples: int, seed: int) -> np.ndarray:
    """[frames, samples, 2] rotations of the camera about x and y, radians, smooth in time."""
    rng = np.random.default_rng(seed)
    moments = np.arange(len(what))[:, None] + np.arange(samples) / samples * EXPOSURE
    turns = np.zeros((*moments.shape, 2))
    for hertz in (0.7, 1.9, 4.3):
        phase = rng.uniform(0, 2 * np.pi, 2)
        turns += np.sin(2 * np.pi * hertz * moments[..., None] / RATE + phase) / hertz
    turns *= TREMBLE / 1.6
    shaken = np.array([kind == "shaken" for kind in what])
    jolt = np.sin(2 * np.pi * 9 * moments[..., None] / RATE + np.array([0.3, 1.7]))
    return turns + SHAKE * jolt * shaken[:, None, None]


def turned(viewmat: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """[4, 4] world to camera after a rotation about the camera's x and y axes."""
    (sx, sy), (cx, cy) = np.sin(turn), np.cos(turn)
    about = np.eye(4)
    about[:3, :3] = [[cy, 0, sy], [sx * sy, cx, -sx * cy], [-cx * sy, sx, cx * cy]]
    return about @ viewmat


def pictures(
    run: Path,
    viewmats: np.ndarray,
    what: list[str],
    K: np.ndarray,
    size: tuple[int, int],
    samples: int,
) -> Iterator[np.ndarray]:
    """Frames [H, W, 3] uint8: the mean over the samples of an exposure; `held` repeats a frame.

    Args:
        run: Folder of the run.
        viewmats: [frames, FINE, 4, 4].
        what: Result of `kinds`.
        K: [3, 3].
        size: Width and height.
        samples: Samples of an exposure without shaking.
    """
    model = open_model(run)
    last = None
    for moments, kind in zip(viewmats, what, strict=True):
        if kind != "held" or last is None:
            if kind != "shaken":
                moments = moments[:: max(1, FINE // samples)]
            total = sum(
                np.clip(
                    gscore.render(
                        model.splats, K, viewmat, *size,
                        background=model.background, antialias=model.antialias,
                    ).rgb, 0, 1,
                )
                for viewmat in moments
            )  # fmt: skip
            last = (total / len(moments) * 255 + 0.5).astype(np.uint8)
        yield last


def main() -> None:
    """Render and write the video."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="a run of `gscore train`")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the .mp4")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--width", type=int, default=800, help="pixels")
    parser.add_argument("--samples", type=int, default=4, help="pictures per exposure")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    model = open_model(args.run)
    if model.data is None:
        parser.error(f"{args.run} is not a run of gscore train")
    cameras = gscore.load_dataset(model.data).scene.cameras
    width = args.width // 2 * 2
    scale = width / float(cameras.widths[0])
    height = round(float(cameras.heights[0]) * scale) // 2 * 2
    K = np.diag([scale, scale, 1.0]) @ cameras.Ks[0]
    what = kinds(round(args.seconds * RATE))
    steps = 4000
    path = orbit_path(cameras.viewmats, steps)
    at = np.minimum((places(what, FINE) * steps).astype(int), steps - 1)
    turns = trembling(what, FINE, args.seed)
    viewmats = np.array(
        [
            [turned(path[i], turn) for i, turn in zip(row, rows, strict=True)]
            for row, rows in zip(at, turns, strict=True)
        ]
    )
    write_video(
        args.output,
        pictures(args.run, viewmats, what, K, (width, height), args.samples),
        fps=float(RATE),
    )
    truth = {
        "K": K.tolist(),
        "frames": [
            {"kind": kind, "viewmat": middle.tolist()}
            for kind, middle in zip(what, viewmats[:, FINE // 2], strict=True)
        ],
    }
    args.output.with_suffix(".json").write_text(json.dumps(truth))


if __name__ == "__main__":
    main()

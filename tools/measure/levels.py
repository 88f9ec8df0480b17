"""Levels of detail of a large model: python tools/measure/levels.py RUN -o FOLDER.

Copies the splats of a finished run many times side by side, builds levels with `gscore lod`, and
renders pictures at 640 x 360 from disk: one camera among the copies, one that shows all of them,
and a walk among them. Each picture has its own process, for its peak memory. The finest level is
compared to the whole model in memory. Existing files in FOLDER are reused.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import gscore
from gscore.frontend import LodModel
from gscore.io.cameras_json import read_cameras_json
from gscore.splats import PARAMETERS, Splats

WIDTH, HEIGHT, FOCAL = 640, 360, 500.0
TOLERANCE = 1.5
"""Distance of copies, relative to the extent of 90 % of their splats."""
STEPS, WARM = 60, 10
"""Pictures of the walk, and the number of first ones that are not measured as they load chunks."""
DRAWN = {
    "among, --lod-px 0": ("among", {"lod_px": 0.0}),
    "all, --lod-px 0": ("all", {"lod_px": 0.0}),
    "all, --lod-px 1": ("all", {"lod_px": 1.0}),
    "all, --lod-px 4": ("all", {"lod_px": 4.0}),
    "all, --lod-splats 400000": ("all", {"lod_px": 1.0, "most": 400_000}),
    "among, --lod-splats 400000": ("among", {"lod_px": 1.0, "most": 400_000}),
}


def tiled(splats: Splats, copies: int) -> tuple[Splats, np.ndarray]:
    """Copies in a square along the two largest axes of the splats, with SH degree 3, and the two
    vectors [2, 3] between neighbours."""
    low, high = np.quantile(splats.means, (0.05, 0.95), axis=0)
    axes = np.argsort(low - high)[:2]
    moves = np.zeros((2, 3), np.float32)
    moves[[0, 1], axes] = TOLERANCE * (high - low)[axes]
    side = int(np.ceil(np.sqrt(copies)))
    places = np.stack(np.divmod(np.arange(copies), side), axis=1) @ moves
    parts = {name: np.concatenate([getattr(splats, name)] * copies) for name in PARAMETERS}
    parts["means"] = (splats.means[None] + places[:, None]).reshape(-1, 3).astype(np.float32)
    missing = 15 - parts["shN"].shape[1]
    parts["shN"] = np.pad(parts["shN"], ((0, 0), (0, missing), (0, 0)))
    return Splats(**parts), moves


def viewmats(run: Path, moves: np.ndarray, copies: int) -> dict[str, np.ndarray]:
    """Viewmats [4, 4] of the camera among the copies and of one that shows all; [STEPS, 4, 4] of
    the walk."""
    cameras = read_cameras_json(run / "cameras.json")
    side = int(np.ceil(np.sqrt(copies)))
    walk = np.repeat(cameras.viewmats[:1], STEPS, axis=0)
    begin = side // 2 * moves.sum(0)
    shifts = begin + np.linspace(0, 1, STEPS)[:, None] * moves[0]
    walk[:, :3, 3] -= shifts @ walk[0, :3, :3].T
    middle, far = (side - 1) / 2 * moves.sum(0), walk[0].copy()
    # Backwards until the square fits into the narrower half of the picture.
    reach = np.abs((side * moves) @ far[:3, :3].T)[:, :2].sum()
    far[:3, 3] = -far[:3, :3] @ middle + np.array([0, 0, FOCAL / HEIGHT * reach])
    return {"among": walk[0], "all": far, "walk": walk}


def picture(model: Path, viewmat: np.ndarray, how: dict[str, float]) -> tuple[np.ndarray, int]:
    """RGB picture and number of rendered splats, of a file of levels or of a whole PLY."""
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    if model.suffix == ".ply":
        splats = gscore.read_splats(model)
        drawn = gscore.render(splats, K, viewmat, WIDTH, HEIGHT, depths=False)
        return drawn.rgb, len(splats)
    with LodModel(model) as levels:
        drawn = levels.render(K, viewmat, WIDTH, HEIGHT, depths=False, **how)
        assert levels.chosen is not None
        return drawn.rgb, levels.chosen.splats


def walked(model: Path, walk: np.ndarray, how: dict[str, float]) -> tuple[float, int]:
    """Median seconds per picture of the walk, and rendered splats."""
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    seconds, counts = [], []
    with LodModel(model) as levels:
        for viewmat in walk:
            began = time.perf_counter()
            levels.render(K, viewmat, WIDTH, HEIGHT, depths=False, **how)
            seconds.append(time.perf_counter() - began)
            assert levels.chosen is not None
            counts.append(levels.chosen.splats)
    return float(np.median(seconds[WARM:])), int(np.median(counts[WARM:]))


def peak_mb() -> float:
    """Peak resident memory of this process, without that of its parent; Linux only."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(status["VmHWM"].split()[0]) / 1e3


def as_process(folder: Path, *words: str) -> dict[str, float]:
    """JSON result of another process of this script."""
    line = [sys.executable, __file__, str(folder), "-o", str(folder), "--one", *words]
    return json.loads(subprocess.check_output(line, text=True))


def tile(folder: Path, run: Path, copies: int) -> None:
    """Write the copies and the cameras."""
    splats, moves = tiled(gscore.read_splats(run / "point_cloud.ply"), copies)
    gscore.write_splats(folder / "tiled.ply", splats)
    np.savez(folder / "views.npz", **viewmats(run, moves, copies))


def one(folder: Path, name: str, where: str, how: dict[str, float]) -> dict[str, float]:
    """Create the copies, or render a picture or the walk; returns its costs."""
    if name == "tile":
        tile(folder, Path(where), int(how["copies"]))
        return {}
    views = np.load(folder / "views.npz")
    if where == "walk":
        seconds, count = walked(folder / "tiled.lod", views[where], how)
        return {"seconds": seconds, "splats": count, "mb": peak_mb()}
    model = folder / ("tiled.ply" if name == "whole" else "tiled.lod")
    rgb, count = picture(model, views[where], how)
    np.save(folder / f"{name}.npy", rgb)
    return {"splats": count, "mb": peak_mb()}


def difference(a: np.ndarray, b: np.ndarray) -> str:
    """Difference of two pictures, as text."""
    most, mse = np.abs(a - b).max() * 255, float(((a - b) ** 2).mean())
    return "the same bits" if most == 0 else f"{most:.2f}/255, {-10 * np.log10(mse):.0f} dB"


def main() -> int:
    """Build, render and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--copies", type=int, default=210)
    parser.add_argument("--one", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    folder: Path = args.output
    if args.one:
        name, where, how = args.one
        print(json.dumps(one(folder, name, where, json.loads(how))))
        return 0
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "tiled.lod").exists():
        as_process(folder, "tile", str(args.run), json.dumps({"copies": args.copies}))
        began = time.perf_counter()
        line = [sys.executable, "-m", "gscore", "lod", folder / "tiled.ply"]
        made = subprocess.Popen([*line, "-o", folder / "tiled.lod", "--quiet"])
        _, status, used = os.wait4(made.pid, 0)
        if status != 0:
            return 1
        seconds, busy = time.perf_counter() - began, used.ru_utime + used.ru_stime
        print(f"Built in {seconds:.0f} s, {busy:.0f} s of processor, {used.ru_maxrss / 1e3:.0f} MB")
    print("| picture | splats drawn | MB | from the whole model |\n|---|---|---|---|", flush=True)
    whole = {}
    for where in ("among", "all"):
        cost = as_process(folder, "whole", where, "{}")
        whole[where] = np.load(folder / "whole.npy")
        print(f"| {where}, the PLY | {cost['splats']:,.0f} | {cost['mb']:,.0f} | |", flush=True)
    for label, (where, how) in DRAWN.items():
        cost = as_process(folder, "levels", where, json.dumps(how))
        found = difference(np.load(folder / "levels.npy"), whole[where])
        print(f"| {label} | {cost['splats']:,.0f} | {cost['mb']:,.0f} | {found} |", flush=True)
    print("| walk | splats drawn | MB | ms per picture |\n|---|---|---|---|", flush=True)
    for how in ({"lod_px": 1.0}, {"lod_px": 4.0}, {"lod_px": 1.0, "most": 400_000}):
        cost = as_process(folder, "walk", "walk", json.dumps(how))
        print(
            f"| {how} | {cost['splats']:,.0f} | {cost['mb']:,.0f} | {1e3 * cost['seconds']:.0f} |"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())

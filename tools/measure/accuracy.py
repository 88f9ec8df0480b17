"""Accuracy: float32 errors by stage, scene and instruction set, for docs/accuracy.md.

`python tools/measure/accuracy.py [--ply point_cloud.ply --cameras CAPTURE] [-o docs/accuracy]`
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.io.ply.splats import read_ply
from gscore.raster import native_library
from gscore.splats import PARAMETERS
from gscore.stress import native, truth
from gscore.stress.compare import ROW_FLOOR
from gscore.stress.scenes import SplatScene, draw_scene

STAGES = {
    "projected mean": ("projected", "means2d"),
    "depth z": ("projected", "depths"),
    "conic": ("projected", "conics"),
    "SH colour": ("projected", "colors"),
    "blended colour": ("pictures", "rgb"),
    "alpha": ("pictures", "alpha"),
    "inverse depth": ("pictures", "inverse_depth"),
    "d/d projected mean": ("gradients", "means2d"),
    "d/d means": ("gradients", "means"),
    "d/d quats": ("gradients", "quats"),
    "d/d scales": ("gradients", "scales"),
    "d/d opacities": ("gradients", "opacities"),
    "d/d SH": ("gradients", "sh0"),
}
PLOTS = {
    "forward": list(STAGES)[:7],
    "backward": list(STAGES)[7:],
}
COLORS = {"avx512": (31, 119, 180), "avx2": (255, 127, 14), "scalar": (44, 160, 44)}
COLORS |= {"neon": (214, 39, 40)}
LOW, HIGH = -9.0, -1.0
"""Range of the plots: powers of ten."""


def main() -> int:
    """Measure, draw plots and print tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ply", type=Path, help="a trained model")
    parser.add_argument("--cameras", type=Path, help="capture of the model")
    parser.add_argument("--view", type=int, default=0, help="view of the capture (default 0)")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/accuracy"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    args.output.mkdir(parents=True, exist_ok=True)
    isas = native_library.available_isas()
    for name, scene in scenes(args):
        true = truth.reference_truth(scene)
        errors = {}
        for isa in isas:
            with native.with_isa(isa):
                drawn = native.draw(scene, true.weights)
            errors[isa] = {stage: stage_errors(stage, drawn, true) for stage in STAGES}
        print(table(name, scene, true, errors))
        if name in ("random", "trained"):
            for direction, stages in PLOTS.items():
                plot(args.output / f"{name}_{direction}.png", stages, errors)
    return 0


def scenes(args: argparse.Namespace) -> Iterator[tuple[str, SplatScene]]:
    """Names and scenes."""
    common = {"count": 1500, "width": 64, "height": 48, "focal": (60.0, 57.0), "overscan": 0.05}
    plain = draw_scene(1, sigma_px=(0.7, 4.0), **common)
    yield "random", plain
    if args.ply:
        yield "trained", trained(args.ply, args.cameras, args.view)
    needles = draw_scene(2, sigma_px=(5.0, 15.0), logits=(-3.0, 1.0), **{**common, "count": 300})
    scales = needles.scales.copy()
    scales[:, 1:] = scales[:, :1] - np.float32(np.log(1e5))
    yield "needles, 1 : 100 000", needles.with_row(slice(None), scales=scales)
    yield (
        "near plane, z 0.011 to 0.1",
        draw_scene(3, sigma_px=(0.7, 4.0), depths=(0.011, 0.1), **common),
    )
    for offset in (1e2, 1e4):
        yield f"origin {offset:.0e} away", away(plain, offset)


def away(scene: SplatScene, offset: float) -> SplatScene:
    """The scene and its camera moved away from the origin and rounded to float32 there, as without
    recentring. The truth refers to the rounded numbers."""
    shift = offset * np.array([1.0, -0.7, 0.3])
    viewmat = scene.viewmat.astype(np.float64)
    viewmat[:3, 3] -= viewmat[:3, :3] @ shift
    means = (scene.means + shift).astype(np.float32)
    return replace(scene, means=means, viewmat=viewmat.astype(np.float32))


def trained(ply: Path, capture: Path, view: int) -> SplatScene:
    """A window of 64 x 48 px in the middle of a view of a trained model."""
    splats = read_ply(ply)
    cameras = load_dataset(DataConfig(source=capture)).scene.cameras
    K = cameras.Ks[view].copy()
    width, height = 64, 48
    K[0, 2] += (width - cameras.widths[view]) // 2
    K[1, 2] += (height - cameras.heights[view]) // 2
    scene = SplatScene(
        **{name: getattr(splats, name) for name in PARAMETERS},
        viewmat=cameras.viewmats[view].astype(np.float32),
        K=K.astype(np.float32),
        width=width,
        height=height,
    )
    # The reference evaluates all splats at all pixels; invisible ones would only cost time.
    return scene.rows(native.draw(scene).radii > 0)


def stage_errors(stage: str, drawn: native.Drawn, true: truth.Truth) -> np.ndarray:
    """Errors of one stage: absolute for pictures outside the band, else relative to the row."""
    kind, name = STAGES[stage]
    actual, expected = getattr(drawn, kind)[name], getattr(true, kind)[name]
    if kind == "pictures":
        scale = max(1.0, float(np.abs(expected).max()))
        return np.abs(actual - expected)[~true.band].ravel() / scale
    visible = (drawn.radii > 0) & (true.projected["depths"] > 0)
    actual, expected = (
        a[visible].astype(np.float64).reshape(int(visible.sum()), -1) for a in (actual, expected)
    )
    length = np.linalg.norm(expected, axis=1)
    keep = length > 0
    floor = max(ROW_FLOOR * float(np.median(length[keep])), 1.0 if name == "colors" else 0.0)
    error = np.abs(actual - expected).max(axis=1)
    return error[keep] / np.maximum(length[keep], floor)


def table(name: str, scene: SplatScene, true: truth.Truth, errors: dict) -> str:
    """Markdown: median, 99.9th percentile and largest error of every stage."""
    alpha, band = true.pictures["alpha"].mean(), true.band.mean()
    lines = [f"\n{name}: {len(scene)} splats, mean alpha {alpha:.2f}, band {band:.2%}\n"]
    lines.append("| stage |" + "".join(f" {isa} |" for isa in errors))
    lines.append("|---|" + "---|" * len(errors))
    for stage in STAGES:
        cells = []
        for found in errors.values():
            e = found[stage]
            cells.append(f" {np.median(e):.0e} / {np.quantile(e, 0.999):.0e} / {e.max():.0e} |")
        lines.append(f"| {stage} |" + "".join(cells))
    return "\n".join(lines)


def plot(path: Path, stages: list[str], errors: dict) -> None:
    """Share of the values above an error, both logarithmic, one panel per stage."""
    width, height, gap, top = 250, 150, 34, 22
    columns = 4
    rows = -(-len(stages) // columns)
    size = (columns * (width + gap) + gap, rows * (height + gap + top) + 24)
    image = Image.new("RGB", size, "white")
    pen = ImageDraw.Draw(image)
    floor = -4.0
    for number, stage in enumerate(stages):
        x0 = gap + number % columns * (width + gap)
        y0 = top + number // columns * (height + gap + top)
        pen.text((x0, y0 - 14), stage, fill="black")
        for power in range(int(LOW), int(HIGH) + 1, 2):
            x = x0 + (power - LOW) / (HIGH - LOW) * width
            pen.line([(x, y0), (x, y0 + height)], fill=(225, 225, 225))
            pen.text((x - 10, y0 + height + 3), f"1e{power}", fill=(90, 90, 90))
        for power in range(int(floor), 1):
            y = y0 + power / floor * height
            pen.line([(x0, y), (x0 + width, y)], fill=(225, 225, 225))
            pen.text((x0 - 26, y - 6), f"1e{power}" if power else "1", fill=(90, 90, 90))
        # Thick lines first: AVX2 and AVX-512 are nearly identical.
        for isa, line in zip(errors, (6, 3, 2, 2), strict=False):
            found = errors[isa]
            e = np.sort(np.maximum(found[stage], 1e-12))
            share = np.log10(1 - np.arange(len(e)) / len(e))
            pick = np.unique(np.linspace(0, len(e) - 1, 400).astype(int))
            pick = np.union1d(pick, np.arange(max(0, len(e) - 60), len(e)))
            xs = x0 + np.clip((np.log10(e[pick]) - LOW) / (HIGH - LOW), 0, 1) * width
            ys = y0 + np.clip(share[pick] / floor, 0, 1) * height
            pen.line(list(zip(xs.tolist(), ys.tolist(), strict=True)), fill=COLORS[isa], width=line)
    for number, isa in enumerate(errors):
        x = gap + 90 * number
        pen.line([(x, size[1] - 10), (x + 22, size[1] - 10)], fill=COLORS[isa], width=3)
        pen.text((x + 28, size[1] - 16), isa, fill="black")
    image.quantize(32).save(path, optimize=True)


if __name__ == "__main__":
    raise SystemExit(main())

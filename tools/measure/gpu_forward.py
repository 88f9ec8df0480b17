"""Graphics card, forward: self-test, pictures against the CPU's, time of each kernel, as JSON.

    python tools/measure/gpu_forward.py [--device gpu] [--tiny] [-o gpu.json]

It needs gscore's wheel, numpy and a Vulkan driver, no checkout and no network, and about three
minutes on a card.
`--tiny` proves the script on a software device.
"""

import argparse
import json
import platform
import sys
from pathlib import Path
from typing import Any

import numpy as np

from gscore.raster import _native
from gscore.raster.gpu.choice import choose, once_a_device
from gscore.raster.gpu.gpu_raster import GpuRaster
from gscore.raster.gpu.timing import picture_of, timed_pictures, timing_splats, timing_view

BANDWIDTH = {"H100": 3.35e12, "H200": 4.8e12, "RTX 4090": 1.008e12, "RTX 3090": 0.936e12}
"""Bytes a second of device memory by the makers' data sheets, by parts of names."""
USED = 0.8
"""Share of it that kernels reach at best."""


def compared(raster: GpuRaster, count: int, width: int) -> dict[str, Any]:
    """Differences to the CPU's picture; rounding may flip a comparison in a few pixels."""
    arrays, view = timing_splats(count), timing_view(width)
    cpu = picture_of(_native.Raster(), arrays, view)
    first, second = (picture_of(raster, arrays, view) for _ in range(2))
    difference = np.abs(first.astype(np.float64) - cpu).max(-1)
    return {
        "splats": count,
        "width": width,
        "same_bits": bool(np.array_equal(first, second)),
        "median": float(np.median(difference)),
        "largest": float(difference.max()),
        "share_above_1e-5": float((difference > 1e-5).mean()),
        "mean_alpha_check": float(cpu.mean()),
    }


def bandwidth_of(name: str) -> float | None:
    """Bytes a second of a device's memory, if its data sheet is known."""
    return next((b for part, b in BANDWIDTH.items() if part in name), None)


def floors(moved: dict[str, float], bandwidth: float | None) -> dict[str, float]:
    """Milliseconds that the bytes of each kernel take; empty where the bandwidth is unknown."""
    return {n: v / (USED * bandwidth) * 1e3 for n, v in moved.items()} if bandwidth else {}


def moved_bytes(times: dict[str, Any]) -> dict[str, float]:
    """Bytes that each kernel of a picture reads and writes, once each, by its counts."""
    n, v, e = times["splats"], times["visible"], times["entries"]
    width, height = times["size"]
    tiles = -(-width // 16) * -(-height // 16)
    passes = -(-(tiles - 1).bit_length() // 4)
    sorted_words = 8 * v + passes * e
    return {
        "project": n * (64 + 192 + 12) + v * 64,
        "compact": 4 * n + 8 * v,
        "sort_count": 4 * sorted_words,
        "sort_scatter": 16 * sorted_words,
        "tile_sums": 8 * v,
        "offsets": 12 * v,
        "emit": 12 * e + 64 * v,
        "ranges": 4 * e,
        "blend": 56 * e + 16 * width * height,
    }


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="gpu", help="gpu, or a number of gscore doctor")
    parser.add_argument("--tiny", action="store_true", help="small, for software devices")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    report = once_a_device(lambda text: print(text, file=sys.stderr))
    chosen = choose(options.device, report=report)
    assert chosen.device is not None
    counts, widths = (
        ((500, 2_000), (64, 96))
        if options.tiny
        else (
            (50_000, 300_000, 1_000_000),
            (400, 1000, 1920),
        )
    )
    result: dict[str, Any] = {"platform": platform.platform(), "device": chosen.device.to_dict()}
    with GpuRaster(chosen.device.number) as raster:
        result["pictures"] = [compared(raster, n, w) for n in counts for w in widths]
        result["times"] = [timed_pictures(raster, n, widths[-1]) for n in counts]
    for times in result["times"]:
        times["kernels_bytes"] = moved_bytes(times)
        times["floors_ms"] = floors(times["kernels_bytes"], bandwidth_of(chosen.device.name))
    text = json.dumps(result, indent=2)
    if options.output:
        options.output.write_text(text + "\n", encoding="utf-8")
    print(text)
    return int(not all(p["same_bits"] and p["share_above_1e-5"] < 5e-3 for p in result["pictures"]))


if __name__ == "__main__":
    sys.exit(main())

"""Graphics card, forward: self-test, pictures against the CPU's, ceilings, kernels.

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
from gscore.raster.gpu.header import TEST_CHAIN, TEST_SUM
from gscore.raster.gpu.timing import picture_of, timed_pictures, timing_splats, timing_view

SIZES = (50_000, 300_000, 1_000_000), (400, 1000, 1920), ((300_000, 1000), (1_000_000, 1920))
"""Splats and widths of compared pictures, and both of timed ones: those of gpu_train.py."""
TINY_SIZES = (500, 2_000), (64, 96), ((2_000, 96),)
"""The same with --tiny."""
CEILING_WORDS, TINY_WORDS = 1 << 26, 1 << 16
"""Words of the kernels that measure ceilings: 768 MB, more than caches hold; and with --tiny."""
CHAIN = 2048
"""Products and sums of TEST_CHAIN per word."""


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


def ceilings(raster: GpuRaster, *, tiny: bool) -> dict[str, float]:
    """Bytes a second of a kernel that reads two words and writes one, and products and sums a
    second of one that does little else; empty where the device has no timer."""
    words = np.full(TINY_WORDS if tiny else CEILING_WORDS, 0.25, np.float32)
    found = {}
    for name, kernel, work in (
        ("bytes_a_second", TEST_SUM, 12),  # which needs both of its words
        ("operations_a_second", TEST_CHAIN, CHAIN),
    ):
        times = []
        for _ in range(3):
            raster.profile(True)
            raster.test(kernel, words)
            times.append(raster.kernel_times()["test"][0])
        if min(times):
            found[name] = work * len(words) / min(times) * 1e3
    raster.profile(False)
    return found


def floors(moved: dict[str, float], ceilings: dict[str, float]) -> dict[str, float]:
    """Milliseconds that the bytes of each kernel take at the measured bandwidth."""
    bandwidth = ceilings.get("bytes_a_second")
    return {n: v / bandwidth * 1e3 for n, v in moved.items()} if bandwidth else {}


def print_kernels(times: dict[str, Any]) -> None:
    """Print the kernels beside their floors, as text."""
    print(f"{'kernel':>16}{'ms':>23}{'MB moved':>12}{'floor, ms':>12}{'ms / floor':>12}")
    for name, value in times["kernels_ms"].items():
        moved, floor = times["kernels_bytes"].get(name), times["floors_ms"].get(name)
        columns = f"{moved / 1e6:12.1f}" if moved else ""
        columns += f"{floor:12.3f}{value / floor:12.1f}" if floor else ""
        print(f"{'':>10}{name:<20}{value:9.3f}{columns}")


def print_table(result: dict[str, Any]) -> None:
    """Print the figures as text."""
    print(result["device"]["name"], result["device"]["driver"])
    for name, value in result["ceilings"].items():
        print(f"{value / 1e9:12.1f} billion {name.replace('_', ' ')}")
    for one in result["times"]:
        print(
            f"{one['splats']:>9} splats, {'x'.join(map(str, one['size']))}: "
            f"{one['pictures_a_second_on_the_device'] or 0:.1f} pictures/s, with the transfer "
            f"{1e3 / one['whole_call_ms']:.1f}, {one['device_bytes'] / 2**20:.0f} MiB"
        )
        print_kernels(one)


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
    counts, widths, timed = TINY_SIZES if options.tiny else SIZES
    result: dict[str, Any] = {"platform": platform.platform(), "device": chosen.device.to_dict()}
    with GpuRaster(chosen.device.number) as raster:
        result["pictures"] = [compared(raster, n, w) for n in counts for w in widths]
        result["times"] = [timed_pictures(raster, *size) for size in timed]
        result["ceilings"] = ceilings(raster, tiny=options.tiny)
    for times in result["times"]:
        times["kernels_bytes"] = moved_bytes(times)
        times["floors_ms"] = floors(times["kernels_bytes"], result["ceilings"])
    if options.output:
        options.output.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print_table(result)
    return int(not all(p["same_bits"] and p["share_above_1e-5"] < 5e-3 for p in result["pictures"]))


if __name__ == "__main__":
    sys.exit(main())

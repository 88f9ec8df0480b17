"""Fuzzing of splat files, damaged: python -m tools.break.splat_files COUNT [FORMAT...]

`make fuzz` generates damage with hypothesis and checks the memory of every file; this script
generates bytes itself and checks memory and time over all of them: a million files per format take
minutes. For USD see tools/break/usd_files.py. Failing files are stored in build/fuzz/found.
"""

import logging
import random
import resource
import sys
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from gscore.errors import GsError  # noqa: E402
from tests.fuzz.bytes_changed import damaged  # noqa: E402
from tests.fuzz.formats import BY_NAME, SPLAT_FORMATS, Format  # noqa: E402

PLYS = [BY_NAME[name] for name in ("ply", "ply_ascii", "ply_compressed")]
MOST_SECONDS, MOST_MEGABYTES = 5.0, 400
"""Limits: CPU time per file, and growth of this process over all files."""


def attack(kind: Format, count: int, seed: int) -> str:
    """Read `count` damaged files; returns a line with the result."""
    rng, ended, slowest = random.Random(seed), Counter(), 0.0
    began, memory = time.monotonic(), megabytes()
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as name:
        root = Path(name)
        kind.write(root)
        good = (root / kind.file).read_bytes()
        for _ in range(count):
            raw = kind.put_json(good, damaged(kind.json_in(good), rng))
            (root / kind.file).write_bytes(raw)
            at = time.process_time()
            try:
                kind.read(root)
                ended["read"] += 1
            except GsError:
                ended["refused"] += 1
            except BaseException:
                keep = ROOT / "build" / "fuzz" / "found"
                keep.mkdir(parents=True, exist_ok=True)
                (keep / kind.name).write_bytes(raw)
                raise
            took = time.process_time() - at
            slowest = max(slowest, took)
            assert took < MOST_SECONDS, f"{kind.name}: {took:.1f} s for {len(raw)} bytes"
    grew = megabytes() - memory
    assert grew < MOST_MEGABYTES, f"{kind.name}: {grew:.0f} MB"
    return (
        f"{kind.name}: {count} files, {ended['read']} read, {ended['refused']} refused, slowest "
        f"{slowest:.2f} s, {grew:.0f} MB more, {time.monotonic() - began:.0f} s, seed {seed}"
    )


def megabytes() -> float:
    """Peak memory of this process."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Test the given formats, or all."""
    count, names = int(sys.argv[1]), sys.argv[2:]
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    for kind in (*SPLAT_FORMATS, *PLYS):
        if not names or kind.name in names:
            print(attack(kind, count, random.randrange(2**31)), flush=True)


if __name__ == "__main__":
    main()

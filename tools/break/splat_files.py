"""Reads damaged files of splats, many a second: python -m tools.break.splat_files COUNT [FORMAT...]

Where `make fuzz` draws its damage from hypothesis and looks at the memory of every file, this one
draws bytes itself and looks at memory and time over all of them: a million files a format take
minutes. USD is read in a process of its own for each file, so it is attacked where it is named:
usdc, usda. What fails is kept in build/fuzz/found.
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
from tests.fuzz.formats import BY_NAME, SPLAT_FORMATS, USD_FORMATS, Format  # noqa: E402

PLYS = [BY_NAME[name] for name in ("ply", "ply_ascii", "ply_compressed")]
MOST_SECONDS, MOST_MEGABYTES = 5.0, 400
"""CPU time for a file, and what all of them together may add to this process."""
_NUMBERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0x7FFFFFFF, 0xFFFFFFFF, 2**40, 2**63 - 1, 2**64 - 1)
_TEXTS = (b"nan", b"-1", b"1e999", b"9" * 400, b"[", b"{", b'"', b"../", b"\0", b"null", b"true")


def damaged(good: bytes, rng: random.Random) -> bytes:
    """Some changes one after the other, most of them where sizes stand."""
    raw = bytearray(good)
    for _ in range(rng.randint(1, 4)):
        if not raw:
            break
        at = rng.randrange(len(raw))
        at = rng.choice((at, at, at % 64, at % 16))
        kind = rng.randrange(8)
        if kind < 2:
            raw[at] ^= 1 << rng.randrange(8)
        elif kind == 2:
            raw[at] = rng.randrange(256)
        elif kind == 3:
            size = rng.choice((2, 4, 8))
            raw[at : at + size] = (rng.choice(_NUMBERS) % 256**size).to_bytes(size, "little")
        elif kind == 4:
            raw[at:at] = rng.choice(_TEXTS)
        elif kind == 5:
            del raw[at:]
        elif kind == 6:
            del raw[at : at + rng.randint(1, 40)]
        else:
            raw[at : at + 16] = rng.randbytes(16)
    return bytes(raw)


def attack(kind: Format, count: int, seed: int) -> str:
    """Read so many damaged files; a line on how that went."""
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
    """The most memory that this process had so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Attack the formats that are named, or all but USD."""
    count, names = int(sys.argv[1]), sys.argv[2:]
    known = [*SPLAT_FORMATS, *PLYS, *(USD_FORMATS if names else ())]
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    for kind in known:
        if not names or kind.name in names:
            print(attack(kind, count, random.randrange(2**31)), flush=True)


if __name__ == "__main__":
    main()

"""Fuzzing of USD files, damaged: python -m tools.break.usd_files COUNT [usda usdc usdz]

Pixar's library may end the process that reads a damaged file, so gscore reads USD in a process of
its own, which takes most of a second to start. Here one process loads the library, reads a good
file and is forked. A fork reads some hundred damaged files and notes which one it is at, so that
where it ends the file is known, and the next fork goes on behind it. Each file has limits of
processor time and memory, and is made of the seed and its number alone.

What may happen is a model, a FormatError, or an end by a signal of the library's; the first of each
signal are read again through `gscore.read_splat_file`, which has to raise FormatError. All else is
a fault: the file is kept in build/fuzz/found, and the program ends with 1.
"""

import contextlib
import logging
import mmap
import os
import random
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

os.environ["PXR_WORK_THREAD_LIMIT"] = "1"  # a fork has none of its parent's threads
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from gscore.errors import FormatError, GsError  # noqa: E402
from gscore.formats import read_splat_file, write_splat_file  # noqa: E402
from gscore.formats.usd_reading import read_usd  # noqa: E402
from gscore.splats import Splats  # noqa: E402
from tests.fuzz.bytes_changed import damaged  # noqa: E402

KINDS = ("usda", "usdc", "usdz")
MOST_SECONDS, MOST_BYTES = 10, 1 << 30
"""Processor time for a file; address space that a fork may take beside its parent's."""
_MOST_WAITED = 120
"""Seconds by the clock, for what waits for ever without computing."""
_A_FORK = 500
"""Files that one fork reads at most."""
_TRIED_AGAIN = 2
"""Files of each signal that are read through gscore."""
_NOTES = struct.Struct("<QQQ")
"""What a fork writes down: the file it is at, how many were read and refused."""
_FAULT = 70
"""Exit code of a fork that met what must not happen."""
_KEPT = ROOT / "build" / "fuzz" / "found"


def attack(kind: str, count: int, seed: int) -> bool:
    """Read so many damaged files and print how that went; whether nothing was at fault."""
    began, ends, faults = time.monotonic(), Counter[str](), 0
    read = refused = 0
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as name:
        folder = Path(name)
        good = _good_file(folder / f"good.{kind}")
        at, notes = 0, mmap.mmap(-1, _NOTES.size)
        while at < count:
            until = min(at + _A_FORK, count)
            notes[:] = _NOTES.pack(at, 0, 0)
            status = _read_in_fork(kind, good, seed, range(at, until), notes, folder)
            at, more_read, more_refused = _NOTES.unpack(notes)
            read, refused = read + more_read, refused + more_refused
            if status == 0:
                at = until
                continue
            end = _end_of(status)
            ends[end] += 1
            raw = _file(good, seed, at)
            if not _is_told(end, ends[end], folder / f"again.{kind}", raw):
                faults += 1
                _keep(folder, raw, f"{kind}-{seed}-{at}-{end.replace(' ', '-')}")
            (folder / f"{at}.{kind}").unlink(missing_ok=True)
            at += 1
    signals = ", ".join(f"{n} ended by {end}" for end, n in sorted(ends.items())) or "none ended"
    print(
        f"{kind}: {count} files, {read} read, {refused} refused, {signals}, {faults} at fault, "
        f"{time.monotonic() - began:.0f} s, seed {seed}",
        flush=True,
    )
    return faults == 0


def _good_file(path: Path) -> bytes:
    """A valid file; read once, so that forks find the library ready."""
    rng = np.random.default_rng(2)
    draw = lambda *shape: rng.normal(size=shape).astype(np.float32)  # noqa: E731
    write_splat_file(
        path,
        Splats(
            means=draw(4, 3),
            quats=draw(4, 4),
            scales=draw(4, 3),
            opacities=draw(4),
            sh0=draw(4, 1, 3),
            shN=draw(4, 3, 3),
        ),
        antialiased=True,
    )
    read_usd(path)
    return path.read_bytes()


def _file(good: bytes, seed: int, number: int) -> bytes:
    return damaged(good, random.Random(f"{seed}/{number}"))


def _read_in_fork(
    kind: str, good: bytes, seed: int, numbers: range, notes: mmap.mmap, folder: Path
) -> int:
    """Wait status of a fork that reads these files."""
    child = os.fork()
    if child:
        return os.waitpid(child, 0)[1]
    try:
        _limit_memory()
        _be_quiet()
        read = refused = 0
        for number in numbers:
            notes[:] = _NOTES.pack(number, read, refused)
            signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
            signal.alarm(_MOST_WAITED)
            path = folder / f"{number}.{kind}"  # layers are known by name
            path.write_bytes(_file(good, seed, number))
            try:
                splats = read_usd(path).splats
                read += 1
                assert all(np.isfinite(array).all() for array in vars(splats).values())
            except GsError:
                refused += 1
            path.unlink()
        notes[:] = _NOTES.pack(numbers.stop, read, refused)
    except BaseException:
        (folder / "fault.txt").write_text(traceback.format_exc())
        os._exit(_FAULT)
    os._exit(0)


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * mmap.PAGESIZE + MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _be_quiet() -> None:
    """The library prints what it finds and, where it aborts, its stack."""
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)


def _end_of(status: int) -> str:
    if os.WIFSIGNALED(status):
        return signal.Signals(os.WTERMSIG(status)).name
    return f"code {os.WEXITSTATUS(status)}"


def _is_told(end: str, number: int, path: Path, raw: bytes) -> bool:
    """Whether an end is one that gscore has a sentence for: tried for the first of its kind."""
    if end in ("SIGPROF", "SIGALRM", "SIGKILL") or not end.startswith("SIG"):
        return False
    if number > _TRIED_AGAIN:
        return True
    path.write_bytes(raw)
    with contextlib.suppress(FormatError):
        read_splat_file(path)
        # Alone it is read: what came before it in its fork mattered.
    return True


def _keep(folder: Path, raw: bytes, name: str) -> None:
    """The file, and what a fork said of it."""
    _KEPT.mkdir(parents=True, exist_ok=True)
    (_KEPT / name).write_bytes(raw)
    said = folder / "fault.txt"
    if said.exists():
        shutil.move(said, _KEPT / f"{name}.txt")


def main() -> None:
    """Attack the kinds that are named, or all."""
    count, names = int(sys.argv[1]), sys.argv[2:] or KINDS
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    fine = [attack(kind, count, random.randrange(2**31)) for kind in names]
    sys.exit(not all(fine))


if __name__ == "__main__":
    main()

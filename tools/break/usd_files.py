"""Fuzzing of USD files, damaged: python -m tools.break.usd_files COUNT [usda usdc usdz]

Pixar's library may end the process that reads a damaged file, so gscore reads USD in a separate
process, which takes most of a second to start. This script loads the library, reads a good file and
forks. A fork reads some hundred damaged files and records its current one, so that the file of a
crash is known and the next fork continues after it. Each file has limits of CPU time and memory,
and depends only on the seed and its number.

Allowed results are a model, a FormatError, or a crash by a signal of the library; the first files
of each signal are read again through `gscore.read_splat_file`, which must raise FormatError. Any
other result is a fault: the file is stored in build/fuzz/found, and the exit code is 1.
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
"""Limits: CPU time per file; address space of a fork beyond its parent's."""
_MOST_WAITED = 120
"""Wall-clock limit, s, for hangs without CPU use."""
_A_FORK = 500
"""Maximum number of files of a fork."""
_TRIED_AGAIN = 2
"""Files of each signal that are read through gscore."""
_NOTES = struct.Struct("<QQQ")
"""State of a fork: current file, numbers of read and refused files."""
_FAULT = 70
"""Exit code of a fork after a fault."""
_KEPT = ROOT / "build" / "fuzz" / "found"


def attack(kind: str, count: int, seed: int) -> bool:
    """Read `count` damaged files and print the result; returns True without faults."""
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
            if not _is_handled(end, ends[end], folder / f"again.{kind}", raw):
                faults += 1
                _keep(folder, raw, f"{kind}-{seed}-{at}-{end.replace(' ', '-')}")
            (folder / f"{at}.{kind}").unlink(missing_ok=True)
            at += 1
    signals = ", ".join(f"{n} ended by {end}" for end, n in sorted(ends.items())) or "none ended"
    print(
        f"{kind}: {count} files, {read} read, {refused} refused, {signals}, {faults} faults, "
        f"{time.monotonic() - began:.0f} s, seed {seed}",
        flush=True,
    )
    return faults == 0


def _good_file(path: Path) -> bytes:
    """A valid file, read once, so that the library is loaded in forks."""
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
    """Silence the messages and stack traces of the library."""
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)


def _end_of(status: int) -> str:
    if os.WIFSIGNALED(status):
        return signal.Signals(os.WTERMSIG(status)).name
    return f"code {os.WEXITSTATUS(status)}"


def _is_handled(end: str, number: int, path: Path, raw: bytes) -> bool:
    """Whether gscore handles such a crash, tested for the first ones of each kind."""
    if end in ("SIGPROF", "SIGALRM", "SIGKILL") or not end.startswith("SIG"):
        return False
    if number > _TRIED_AGAIN:
        return True
    path.write_bytes(raw)
    with contextlib.suppress(FormatError):
        read_splat_file(path)
        # It can be read alone: the crash depended on earlier files of the fork.
    return True


def _keep(folder: Path, raw: bytes, name: str) -> None:
    """Store the file, and the traceback of its fork."""
    _KEPT.mkdir(parents=True, exist_ok=True)
    (_KEPT / name).write_bytes(raw)
    trace = folder / "fault.txt"
    if trace.exists():
        shutil.move(trace, _KEPT / f"{name}.txt")


def main() -> None:
    """Test the given kinds, or all."""
    count, names = int(sys.argv[1]), sys.argv[2:] or KINDS
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    fine = [attack(kind, count, random.randrange(2**31)) for kind in names]
    sys.exit(not all(fine))


if __name__ == "__main__":
    main()

"""Fuzzing of the native library for crashes: make fuzz FUZZ_SECONDS=60.

The C entry points with libFuzzer under the address and undefined-behaviour sanitizers (needs clang
and its runtime, Debian's clang and libclang-rt-*-dev; without it, random bytes in the plain build),
every reader on damaged files, and random hostile scenes on every instruction set. Inputs that crash
are stored in build/fuzz/found; after a fix they become cases under tests/fuzz/cases.
"""

import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

from gscore.raster import _native

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "fuzz"
TARGETS = {
    "raster": 0.13,
    "loss": 0.05,
    "blur": 0.02,
    "adam": 0.05,
    "catch_up": 0.1,
    "arrays": 0.05,
    "stereo": 0.1,
    "mesh": 0.05,
    "light": 0.05,
    "match": 0.05,
}
READERS, SCENES = 0.25, 0.1
"""Shares of the time; all shares sum to 1."""
FORMATS = 52


def run(*command: str, **environment: str) -> int:
    """Run a command with output to the terminal; returns its exit code."""
    print("+", *command, flush=True)
    return subprocess.run(command, cwd=ROOT, env=os.environ | environment, check=False).returncode


def build(clang: str) -> bool:
    """Build the targets; returns success."""
    tools = Path(sys.executable).parent
    configure = ["-G", "Ninja", "-S", "csrc", "-B", str(BUILD), "-DCMAKE_BUILD_TYPE=Release"]
    configure += [f"-DCMAKE_MAKE_PROGRAM={tools / 'ninja'}", f"-DCMAKE_CXX_COMPILER={clang}"]
    configure += ["-DGS_FUZZ=ON", "-DGS_SANITIZE=address,undefined"]
    cmake = str(tools / "cmake")
    return run(cmake, *configure) == 0 and run(cmake, "--build", str(BUILD)) == 0


def native(seconds: float) -> int:
    """Fuzz the C entry points; returns the number of failures."""
    found = BUILD / "found"
    found.mkdir(parents=True, exist_ok=True)
    clang = shutil.which("clang++")
    if clang is None or not build(clang):
        print("No clang with libFuzzer: using random bytes in the plain build.", flush=True)
        rounds = str(int(200 * seconds))
        return sum(
            run(str(ROOT / "build" / "native" / f"replay_{t}"), rounds) != 0 for t in TARGETS
        )
    failed = 0
    for target, share in TARGETS.items():
        corpus = BUILD / f"corpus_{target}"
        corpus.mkdir(exist_ok=True)
        options = [f"-max_total_time={max(int(share * seconds), 1)}", "-len_control=0"]
        options += ["-max_len=400", "-timeout=300", "-rss_limit_mb=3000", "-print_final_stats=1"]
        options += ["-verbosity=0", f"-artifact_prefix={found}/{target}_"]
        seeds = str(ROOT / "tests" / "fuzz" / "cases" / target)
        failed += run(str(BUILD / f"fuzz_{target}"), *options, str(corpus), seeds) != 0
    return failed


def main() -> int:
    """Run all fuzzers; returns 1 if something was found."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    pytest = [sys.executable, "-m", "pytest", "-q", "-s"]
    os.environ.setdefault("FUZZ_SEED", str(random.randrange(2**31)))
    print(f"FUZZ_SEED={os.environ['FUZZ_SEED']} repeats the random scenes and bytes.", flush=True)
    failed = native(seconds)
    each = str(READERS * seconds / FORMATS)
    failed += run(*pytest, "tests/fuzz/test_readers.py", FUZZ_SECONDS=each) != 0
    each = str(SCENES * seconds / len(_native.available_isas()))
    failed += run(*pytest, "tests/fuzz/test_scenes.py", FUZZ_SECONDS=each) != 0
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

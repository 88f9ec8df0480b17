"""SPIR-V of the shaders: compiles csrc/gpu/shaders/*.comp into csrc/gpu/shaders/spirv/.

`python tools/build/shaders.py` needs glslangValidator and spirv-val (Debian's glslang-tools and
spirv-tools) and writes the files and sources.json: the hash of the sources and the compiler's
version. `--check` fails if the sources have changed since, and, with the same compiler at hand, if
it gives other bytes.
"""

import hashlib
import json
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from error_exit import exit_with_message

ROOT = Path(__file__).parents[2]
SHADERS = ROOT / "csrc" / "gpu" / "shaders"
SPIRV = SHADERS / "spirv"
STATED = SPIRV / "sources.json"
INCLUDES = [SHADERS, SHADERS.parent, ROOT / "csrc" / "shared"]
_HEADER_WORDS = 5
_DECORATE, _NO_CONTRACTION = 71, 42
_TYPES = range(19, 40)
"""Opcodes of type declarations, which follow the decorations."""
_FLOAT_ARITHMETIC = {127, 129, 131, 133, 136, 140, 141, 142, 143, 144, 145, 146, 147, 148}
"""Negation, sum, difference, product, quotient, remainders, and products of vectors."""


def sources_hash() -> str:
    """SHA-256 of all sources, by their names in order."""
    found = hashlib.sha256()
    names = sorted([*SHADERS.glob("*.comp"), *SHADERS.glob("*.glsl")])
    names_of_headers = ("frame.h", "loss_frame.h", "model_push.h", "step.h")
    headers = [SHADERS.parent / name for name in names_of_headers]
    for path in [*names, *headers, *sorted(INCLUDES[-1].glob("*.h"))]:
        found.update(path.name.encode() + b"\0" + path.read_bytes())
    return found.hexdigest()


def compiler_version() -> str:
    """First line of the compiler's version; empty if it is not installed."""
    if shutil.which("glslangValidator") is None:
        return ""
    run = subprocess.run(["glslangValidator", "--version"], capture_output=True, text=True)
    return run.stdout.splitlines()[0]


def _instructions(words: list[int]) -> Iterator[tuple[int, int, int]]:
    """Offset, opcode and length of each instruction."""
    at = _HEADER_WORDS
    while at < len(words):
        yield at, words[at] & 0xFFFF, words[at] >> 16
        at += words[at] >> 16


def without_contraction(code: bytes) -> bytes:
    """The module with all float arithmetic decorated NoContraction.

    A driver may not fuse a product and a sum then, so that bits do not depend on its choices; what
    is to be fused where that is fast calls fma().
    """
    words = list(struct.unpack(f"<{len(code) // 4}I", code))
    targets, decorated, first_type = [], set(), 0
    for at, opcode, _ in _instructions(words):
        if opcode == _DECORATE and words[at + 2] == _NO_CONTRACTION:
            decorated.add(words[at + 1])
        elif opcode in _TYPES and not first_type:
            first_type = at
        elif opcode in _FLOAT_ARITHMETIC:
            targets.append(words[at + 2])
    added = [
        word
        for target in targets
        if target not in decorated
        for word in (3 << 16 | _DECORATE, target, _NO_CONTRACTION)
    ]
    words[first_type:first_type] = added
    return struct.pack(f"<{len(words)}I", *words)


def compiled(source: Path) -> bytes:
    """SPIR-V of a shader. Raises RuntimeError with the compiler's message."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "shader.spv"
        includes = [f"-I{path}" for path in INCLUDES]
        command = ["glslangValidator", "-g0", "--target-env", "vulkan1.2", *includes, "-V"]
        _run([*command, str(source), "-o", str(out)])
        out.write_bytes(without_contraction(out.read_bytes()))
        _run(["spirv-val", "--target-env", "vulkan1.2", str(out)])
        return out.read_bytes()


def _run(command: list[str]) -> None:
    run = subprocess.run(command, capture_output=True, text=True)
    if run.returncode:
        raise RuntimeError(f"{command[0]} failed:\n{run.stdout}{run.stderr}")


@exit_with_message
def main() -> None:
    """Compile all shaders, or check the files."""
    version, stated = compiler_version(), {}
    if STATED.is_file():
        stated = json.loads(STATED.read_text(encoding="utf-8"))
    check = sys.argv[1:] == ["--check"]
    if check and stated.get("sha256") != sources_hash():
        raise RuntimeError("the shaders have changed since; run tools/build/shaders.py")
    if check and stated.get("compiler") != version:
        print("Only the hash of the sources was checked: the compiler is", version or "missing")
        return
    if not version:
        raise RuntimeError("glslangValidator is missing (Debian: glslang-tools, spirv-tools)")
    SPIRV.mkdir(exist_ok=True)
    for source in sorted(SHADERS.glob("*.comp")):
        code, out = compiled(source), SPIRV / f"{source.stem}.spv"
        if not check:
            out.write_bytes(code)
        elif not out.is_file() or out.read_bytes() != code:
            raise RuntimeError(f"{out.name} is not what {source.name} compiles to")
    if not check:
        text = json.dumps({"compiler": version, "sha256": sources_hash()}, indent=2)
        STATED.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())

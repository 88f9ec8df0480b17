"""SPIR-V of the shaders: compiles csrc/gpu/shaders/*.comp into csrc/gpu/shaders/spirv/.

`python tools/build/shaders.py` needs glslangValidator, spirv-val and spirv-cross (Debian's
glslang-tools, spirv-tools and spirv-cross) and writes the files and sources.json: the hash of the
sources and the compiler's version. `--check` fails if the sources have changed since, and, with the
same compiler at hand, if it gives other bytes.
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
_MEMBER_DECORATE, _OFFSET, _TYPE_VECTOR, _TYPE_STRUCT = 72, 35, 23, 30
_TYPES_OF_ONE = {24, 28, 29}
"""Matrices and arrays."""
_TOOLS = "glslangValidator", "spirv-val", "spirv-cross"
_PACKAGES = "glslang-tools, spirv-tools, spirv-cross"
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
    """First line of the compiler's version; empty if it or another tool is not installed."""
    if not all(map(shutil.which, _TOOLS)):
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


def three_vectors_in_memory(code: bytes) -> list[int]:
    """Ids of structs in memory that contain vectors or matrix columns of three, which MoltenVK
    mishandles behind pointers."""
    words = list(struct.unpack(f"<{len(code) // 4}I", code))
    threes, in_memory, found = set(), set(), []
    for at, opcode, length in _instructions(words):
        operands = words[at + 1 : at + length]
        if opcode == _MEMBER_DECORATE and operands[2] == _OFFSET:
            in_memory.add(operands[0])
        elif (opcode, operands[2:]) == (_TYPE_VECTOR, [3]) or (
            opcode in _TYPES_OF_ONE and operands[1] in threes
        ):
            threes.add(operands[0])
        elif opcode == _TYPE_STRUCT and operands[0] in in_memory and threes & {*operands[1:]}:
            found.append(operands[0])
    return found


def check_for_metal(path: Path) -> None:
    """Raise RuntimeError if MoltenVK, which translates with SPIRV-Cross, could not run a module."""
    if three_vectors_in_memory(path.read_bytes()):
        raise RuntimeError(f"{path.name} has a 3-vector behind a pointer; use float[3]")
    text = _run(["spirv-cross", "--msl", "--msl-version", "20300", str(path)])
    if "reinterpret_cast" in text:
        raise RuntimeError(f"{path.name} casts a pointer: a buffer has two types of pointers")


def compiled(source: Path) -> bytes:
    """SPIR-V of a shader. Raises RuntimeError with the compiler's message."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "shader.spv"
        includes = [f"-I{path}" for path in INCLUDES]
        command = ["glslangValidator", "-g0", "--target-env", "vulkan1.2", *includes, "-V"]
        _run([*command, str(source), "-o", str(out)])
        out.write_bytes(without_contraction(out.read_bytes()))
        _run(["spirv-val", "--target-env", "vulkan1.2", str(out)])
        check_for_metal(out)
        return out.read_bytes()


def _run(command: list[str]) -> str:
    """The output of a program. Raises RuntimeError with its message."""
    run = subprocess.run(command, capture_output=True, text=True)
    if run.returncode:
        raise RuntimeError(f"{command[0]} failed:\n{run.stdout}{run.stderr}")
    return run.stdout


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
        raise RuntimeError(f"{', '.join(_TOOLS)} are needed (Debian: {_PACKAGES})")
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

"""The committed SPIR-V; oracles: its sources, and the SPIR-V specification's numbers."""

import re
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from runpy import run_path
from typing import Any

import pytest

from tests.for_each import for_each
from tests.gpu.drivers import absent, required

ROOT = Path(__file__).parents[2]
GPU = ROOT / "csrc" / "gpu"
SPIRV = sorted((GPU / "shaders" / "spirv").glob("*.spv"))
TOOL = ROOT / "tools" / "build" / "shaders.py"
CAPABILITIES = {1, 5347}
"""Shader and PhysicalStorageBufferAddresses: no other is needed, as gscore_gpu.h promises."""
SUBGROUP_OPERATIONS = range(333, 367)
ATOMIC_FLOAT_OPERATIONS = {5614, 5615, 6035}
"""Minimum, maximum and sum."""


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Functions of tools/build/shaders.py by name."""
    monkeypatch.syspath_prepend(str(TOOL.parent))
    return run_path(str(TOOL))


def instructions(path: Path) -> Iterator[list[int]]:
    """Words of each instruction; the first has length and opcode."""
    data = path.read_bytes()
    words = struct.unpack(f"<{len(data) // 4}I", data)
    at = 5
    while at < len(words):
        yield list(words[at : at + (words[at] >> 16)])
        at += words[at] >> 16


def test_the_files_are_current() -> None:
    """Oracle: the hash of the sources, and with the same compiler at hand its output."""
    done = subprocess.run([sys.executable, TOOL, "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    if required():
        assert done.stdout == "", "the compiler is missing or another"


@for_each(SPIRV)
def test_shaders_need_no_more_than_stated(path: Path) -> None:
    """Oracle: csrc/include/gscore_gpu.h: capabilities, subgroups and atomics."""
    found = [(words[0] & 0xFFFF, words) for words in instructions(path)]
    assert {words[1] for code, words in found if code == 17} == CAPABILITIES
    codes = {code for code, _ in found}
    assert not codes & {*SUBGROUP_OPERATIONS, *ATOMIC_FLOAT_OPERATIONS}


@for_each(SPIRV)
def test_nothing_is_fused(path: Path) -> None:
    """Oracle: the decoration NoContraction (42) on each sum, difference, product and quotient of
    floats."""
    decorated, arithmetic = set(), set()
    for words in instructions(path):
        code = words[0] & 0xFFFF
        if code == 71 and words[2] == 42:
            decorated.add(words[1])
        elif code in {127, 129, 131, 133, 136, 142}:
            arithmetic.add(words[2])
    assert arithmetic <= decorated


def test_a_fused_module_is_noticed(tool) -> None:
    """Oracle: a module of one sum, by hand: the tool adds a decoration before the first type."""
    header = [0x07230203, 0x00010500, 0, 9, 0]
    type_float, function_sum = [3 << 16 | 22, 1, 32], [5 << 16 | 129, 1, 5, 2, 3]
    code = struct.pack("<13I", *header, *type_float, *function_sum)
    found = tool["without_contraction"](code)
    decoration = [3 << 16 | 71, 5, 42]
    expected = [*header, *decoration, *type_float, *function_sum]
    assert struct.unpack(f"<{len(found) // 4}I", found) == tuple(expected)


@pytest.mark.parametrize("path", SPIRV, ids=lambda path: path.stem)
def test_shaders_translate_to_metal(tool, path: Path) -> None:
    """Oracle: SPIRV-Cross, which MoltenVK translates with."""
    if shutil.which("spirv-cross") is None:
        absent("spirv-cross is not installed.")
    tool["check_for_metal"](path)


@pytest.mark.parametrize(
    ("block", "use", "words"),
    [
        ("uint n; vec3 v;", "o.at[0] = vec4(o.in_.v, 1)", "3-vector"),
        ("mat3 m[2];", "o.at[0] = vec4(o.in_.m[1][0], 1)", "3-vector"),
        ("float v[3]; vec4 w;", "o.at[0] = vec4(o.in_.v[0]) + o.in_.w", ""),
        ("vec4 w;", "o.at[0] = vec4(other(uvec2(o)).at[1])", "casts a pointer"),
    ],
)
def test_what_metal_cannot_run_is_refused(
    tool, tmp_path: Path, block: str, use: str, words: str
) -> None:
    """Oracle: compiled GLSL with and without 3-vectors in memory and casts of pointers."""
    if shutil.which("glslangValidator") is None or shutil.which("spirv-cross") is None:
        absent("glslangValidator or spirv-cross is not installed.")
    source, module = tmp_path / "a.comp", tmp_path / "a.spv"
    source.write_text(
        "#version 450\n"
        "#extension GL_EXT_buffer_reference : require\n"
        "#extension GL_EXT_buffer_reference_uvec2 : require\n"
        f"struct inner {{ {block} }};\n"
        "layout(buffer_reference, std430) buffer other { float at[]; };\n"
        "layout(buffer_reference, std430) buffer block { inner in_; vec4 at[]; };\n"
        "layout(push_constant) uniform pushed { block o; };\n"
        f"void main() {{ {use}; }}\n"
    )
    command = ["glslangValidator", "--target-env", "vulkan1.2", "-V", source, "-o", module]
    subprocess.run(command, check=True, capture_output=True)
    if not words:
        tool["check_for_metal"](module)
        return
    with pytest.raises(RuntimeError, match=words):
        tool["check_for_metal"](module)


def test_the_library_knows_all_shaders_in_one_order() -> None:
    """Oracle: the sources; the enumeration in shaders.h has their names in the order of CMake's
    glob."""
    names = sorted(path.stem for path in (GPU / "shaders").glob("*.comp"))
    assert [path.stem for path in SPIRV] == names
    header = (GPU / "shaders.h").read_text(encoding="utf-8")
    (members,) = re.findall(r"enum class Shader \{(.*?)\}", header, flags=re.DOTALL)
    camel = [re.sub(r"(?:^|_)(\w)", lambda m: m[1].upper(), name) for name in names]
    assert re.findall(r"k(\w+)", members) == [*camel, "Count"]

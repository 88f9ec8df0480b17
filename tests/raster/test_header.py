"""Structs and constants in ctypes; oracle: the headers in csrc/include and a C compiler."""

import ctypes as ct
import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from gscore.raster import header
from gscore.raster.gpu import header as gpu_header

CSRC = Path(__file__).parents[2] / "csrc"
HEADERS = sorted([*(CSRC / "include").rglob("*.h"), *(CSRC / "shared").glob("*.h")])
TEXT = "".join(path.read_text(encoding="utf-8") for path in HEADERS)
"""Text of all headers."""
STRUCTS = {
    re.sub(r"(?<!^)(?=[A-Z])", "_", name.removesuffix("Struct")).lower(): struct
    for name, struct in (vars(header) | vars(gpu_header)).items()
    if isinstance(struct, type) and issubclass(struct, ct.Structure)
}
"""By the header's name without gs_."""
CONSTANTS = {
    "GS_ABI_VERSION": header.ABI_VERSION,
    "GS_TILE": header.TILE,
    "GS_LIST_TILE_WIDTH": header.LIST_TILE[0],
    "GS_LIST_TILE_HEIGHT": header.LIST_TILE[1],
    "GS_THREADS_MAX": header.THREADS_MAX,
    "GS_OUT_INVERSE_DEPTH": header.OUT_INVERSE_DEPTH,
    "GS_OUT_DEPTH": header.OUT_DEPTH,
    "GS_OUT_MEDIAN_DEPTH": header.OUT_MEDIAN_DEPTH,
    "GS_COUNT_USEFUL": header.COUNT_USEFUL,
    "GS_MEDIAN_SPLAT": header.MEDIAN_SPLAT,
    "GS_NO_EXACT_CULL": header.NO_EXACT_CULL,
    "GS_NO_ZERO_TILE": header.NO_ZERO_TILE,
    "GS_NO_OPACITY_EXTENT": header.NO_OPACITY_EXTENT,
    "GS_NO_ROW_RANGE": header.NO_ROW_RANGE,
    "GS_ADAM_ALL": header.ADAM_ALL,
    "GS_ADAM_VISIBLE": header.ADAM_VISIBLE,
    "GS_ADAM_WAIT": header.ADAM_WAIT,
    "GS_ADAM_PENDING_SIZE": header.ADAM_PENDING_SIZE,
    "GS_MASK_NONE": header.MASK_MODES["none"],
    "GS_MASK_COMPOSITE": header.MASK_MODES["composite"],
    "GS_MASK_IGNORE": header.MASK_MODES["ignore"],
    "GS_STEREO_PLANES_MAX": header.STEREO_PLANES_MAX,
    "GS_OK": header.OK,
    "GS_BAD_ARGUMENT": header.BAD_ARGUMENT,
    "GS_OUT_OF_MEMORY": header.OUT_OF_MEMORY,
    "GS_CANCELLED": header.CANCELLED,
    "GS_GPU_ABI_VERSION": gpu_header.ABI_VERSION,
    "GS_UNSUPPORTED": gpu_header.UNSUPPORTED,
    "GS_DEVICE_LOST": gpu_header.DEVICE_LOST,
    "GS_TIMED_OUT": gpu_header.TIMED_OUT,
    **{f"GS_GPU_{kind.upper()}": i for i, kind in enumerate(gpu_header.KINDS)},
    "GS_GPU_VALUES": gpu_header.VALUES,
    "GS_GPU_MOMENT1": gpu_header.MOMENT1,
    "GS_GPU_MOMENT2": gpu_header.MOMENT2,
    "GS_GPU_ACCUMULATED": gpu_header.ACCUMULATED,
    "GS_GPU_COUNTERS": gpu_header.COUNTERS,
    "GS_GPU_SHN": gpu_header.SHN,
    "GS_GPU_TEST_EXP2": gpu_header.TEST_EXP2,
    "GS_GPU_TEST_NATIVE_EXP2": gpu_header.TEST_NATIVE_EXP2,
    "GS_GPU_TEST_PRODUCT": gpu_header.TEST_PRODUCT,
    "GS_GPU_TEST_SUM": gpu_header.TEST_SUM,
    "GS_GPU_TEST_FMA": gpu_header.TEST_FMA,
    "GS_GPU_TEST_SORT": gpu_header.TEST_SORT,
    "GS_GPU_TEST_CHAIN": gpu_header.TEST_CHAIN,
}
KINDS = {
    ct.c_float: "float",
    ct.c_double: "double",
    ct.c_int32: "int32",
    ct.c_uint32: "uint32",
    ct.c_int64: "int64",
    ct.c_uint64: "uint64",
    ct.c_uint8: "uint8",
    ct.c_char: "char",
}
"""Everything else is a pointer."""
_PROGRAM = r"""
#include "gscore.h"
#include "gscore_gpu.h"
#include <stddef.h>
#include <stdio.h>
#define KIND(x) _Generic((x), float: "float", double: "double", int32_t: "int32", \
    uint32_t: "uint32", int64_t: "int64", uint64_t: "uint64", \
    uint8_t: "uint8", char: "char", default: "pointer")
#define SIZE(s) printf("gs_" #s " %zu\n", sizeof(gs_##s));
#define FIELD(s, f, first) printf("gs_" #s "." #f " %zu %zu %s\n", offsetof(gs_##s, f), \
    sizeof(((gs_##s *)0)->f), KIND(((gs_##s *)0)->first));
#define CONSTANT(c) printf(#c " %d\n", (int)(c));
int main(void) {
    gs_LINES
    return 0;
}
"""


def _element(kind: type) -> type:
    return getattr(kind, "_type_", kind) if issubclass(kind, ct.Array) else kind


def _compiler() -> list[str]:
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        command = shlex.split(name)
        if command and shutil.which(command[0]):
            return command
    pytest.skip("there is no C compiler: neither CC nor cc, gcc or clang")


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The output of a program that includes the header, by the first word of each line."""
    folder = tmp_path_factory.mktemp("header")
    lines = [f"CONSTANT({name})" for name in CONSTANTS]
    for name, struct in STRUCTS.items():
        lines.append(f"SIZE({name})")
        for field, kind in struct._fields_:
            first = f"{field}[0]" if issubclass(kind, ct.Array) else field
            lines.append(f"FIELD({name}, {field}, {first})")
    source, program = folder / "layout.c", folder / "layout"
    source.write_text(_PROGRAM.replace("gs_LINES", "\n    ".join(lines)), encoding="utf-8")
    command = [*_compiler(), "-std=c11", f"-I{CSRC / 'include'}", str(source), "-o", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"a name that the header does not have: {done.stderr}"
    printed = subprocess.run([str(program)], capture_output=True, text=True, check=True).stdout
    return dict(line.split(" ", 1) for line in printed.splitlines())


def test_constants_are_those_of_the_header(compiled: dict[str, str]) -> None:
    """Oracle: their values in C."""
    assert {name: int(compiled[name]) for name in CONSTANTS} == CONSTANTS


@pytest.mark.parametrize("name", STRUCTS)
def test_structs_lie_in_memory_as_in_c(compiled: dict[str, str], name: str) -> None:
    """Oracle: size of the struct; offset, size and kind of number of every field."""
    struct = STRUCTS[name]
    assert int(compiled[f"gs_{name}"]) == ct.sizeof(struct)
    for field, kind in struct._fields_:
        place = getattr(struct, field)
        reported = f"{place.offset} {place.size} {KINDS.get(_element(kind), 'pointer')}"
        assert compiled[f"gs_{name}.{field}"] == reported, field


@pytest.mark.parametrize("name", STRUCTS)
def test_no_field_is_left_out(name: str) -> None:
    """Oracle: the names between the header's braces, in their order."""
    text = re.sub(r"/\*.*?\*/", "", TEXT, flags=re.DOTALL)
    found = re.search(rf"struct gs_{name} \{{(.*?)\}}", text, flags=re.DOTALL)
    assert found is not None
    names = [
        re.findall(r"\w+", re.sub(r"\[.*?\]", "", part))[-1]
        for declaration in found[1].split(";")
        for part in declaration.split(",")
        if part.strip()
    ]
    assert names == [field for field, _ in STRUCTS[name]._fields_]


def test_every_struct_of_the_header_is_here() -> None:
    """Oracle: the header's typedefs with a body."""
    found = re.findall(r"struct gs_(\w+) \{", TEXT)
    assert set(found) == set(STRUCTS)

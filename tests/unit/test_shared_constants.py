"""Shared constants; oracle: closed forms, and the text of the sources."""

import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gscore import shared_constants as c
from gscore.glsl import glsl_defines

ROOT = Path(__file__).parents[2]
HEADER = ROOT / "csrc" / "shared" / "constants.h"
PROGRAM = ROOT / "tools" / "build" / "shared_constants.py"
_SHARED = "ALPHA_MIN COMPENSATION_MIN EPS2D JACOBIAN_MARGIN"
NAMES = [name for name in vars(c) if name.isupper()]
SOURCES = sorted(
    path
    for folder in ("gscore", "addon", "csrc/src", "csrc/include")
    for path in (ROOT / folder).rglob("*")
    if path.suffix in {".py", ".cpp", ".h", ".js", ".vert", ".frag"}
    and path != Path(c.__file__).resolve()
)


def test_python_follows_the_header() -> None:
    """Oracle: tools/build/shared_constants.py, which reads the header."""
    assert subprocess.run([sys.executable, PROGRAM, "--check"], check=False).returncode == 0
    text = HEADER.read_text(encoding="utf-8")
    assert re.findall(r"#define GS_(\w+) ", text) == NAMES


def test_every_constant_has_a_reason() -> None:
    """Oracle: the header: between two paragraphs there is a comment above the first constant."""
    text = HEADER.read_text(encoding="utf-8").replace("\\\n", " ")
    previous = ""
    for line in text.splitlines():
        if re.match(r"#define GS_\w+ ", line):
            assert previous.endswith("*/") or previous.startswith("#define GS_"), line
        previous = line


def test_spherical_harmonics_are_normalised() -> None:
    """Oracle: closed forms (Sloan 2013)."""
    pi = math.pi
    second = [15 / (4 * pi), 15 / (4 * pi), 5 / (16 * pi), 15 / (4 * pi), 15 / (16 * pi)]
    third = [35 / 32, 105 / 4, 21 / 32, 7 / 16, 21 / 32, 105 / 16, 35 / 32]
    fourth = [315 / 16, 315 / 32, 45 / 16, 45 / 32, 9 / 256, 45 / 32, 45 / 64, 315 / 32, 315 / 256]
    found = np.array([c.SH_C0, c.SH_C1, *c.SH_C2, *c.SH_C3, *c.SH_C4])
    squares = [1 / (4 * pi), 3 / (4 * pi), *second, *(x / pi for x in [*third, *fourth])]
    np.testing.assert_allclose(found**2, squares, rtol=1e-15)


def test_derived_values_follow_from_the_others() -> None:
    """Oracle: their definitions in double precision; the taps are those of float32 arithmetic."""
    assert math.isclose(c.LOG2_ALPHA_MIN, math.log2(c.ALPHA_MIN), rel_tol=1e-15)
    assert math.isclose(c.HALF_LOG2E, math.log2(math.e) / 2, rel_tol=1e-15)
    assert 0 <= c.REACH - math.sqrt(-2 * math.log(c.ALPHA_MIN)) < 0.02
    taps = np.exp(-(np.arange(6) ** 2) / (2 * c.SSIM_SIGMA**2))
    np.testing.assert_allclose(c.SSIM_TAPS, taps / (2 * taps.sum() - 1), rtol=4e-8)
    assert 2 * len(c.SSIM_TAPS) - 1 == c.SSIM_WINDOW
    assert math.isclose(c.SSIM_C1, 1e-4) and math.isclose(c.SSIM_C2, 9e-4)


@pytest.mark.parametrize(("degree", "error"), [(3, 1.1e-4), (4, 4e-6), (5, 2.4e-7), (6, 2e-8)])
def test_polynomials_approximate_powers_of_two(degree: int, error: float) -> None:
    """Oracle: 2^x in double precision."""
    x = np.linspace(-0.5, 0.5, 4001)
    found = np.polyval(getattr(c, f"EXP2_{degree}"), x)
    assert np.abs(found / 2.0**x - 1).max() < error


def copied(text: str) -> list[str]:
    """Numbers of five digits or more that equal a constant, and GS_REACH."""
    known = {
        f"{abs(value):.5g}"
        for name in NAMES
        for value in np.atleast_1d(getattr(c, name))
        if len(f"{abs(value):.5g}".lstrip("0.")) >= 5
    }
    numbers = re.findall(r"(?<![\w.])\d+\.\d+(?:e-?\d+)?", text)
    return [n for n in numbers if f"{float(n):.5g}" in known or n == str(c.REACH)]


def test_no_copy_is_left() -> None:
    """Oracle: the text of all sources, and copies as they were."""
    found = {path.name: copied(path.read_text(encoding="utf-8")) for path in SOURCES}
    assert {name: numbers for name, numbers in found.items() if numbers} == {}
    assert copied("x = 1.0925484f * 0.26601172 + 3.34 + 0.30000 + 0.2402212") == [
        "1.0925484",
        "0.26601172",
        "3.34",
        "0.2402212",
    ]


@pytest.mark.parametrize(
    ("path", "macros"),
    [
        (
            "gscore/page/splat.vert",
            "ALPHA_MIN COMPENSATION_MIN EPS2D JACOBIAN_MARGIN SH_C1 SH_C2 SH_C3",
        ),
        ("gscore/page/splat.frag", "ALPHA_MAX ALPHA_MIN"),
        ("addon/live/program.py", f"ALPHA_MAX {_SHARED}"),
    ],
)
def test_shaders_name_the_rules_of_the_rasterizer(path: str, macros: str) -> None:
    """Oracle: the steps of docs/conventions.md that a shader takes."""
    found = glsl_defines((ROOT / path).read_text(encoding="utf-8"))
    assert list(found) == [f"GS_{name}" for name in macros.split()]
    text = (ROOT / path).read_text(encoding="utf-8")
    assert re.findall(r"255\.0|\b0\.99\b|\b0\.3\b|\b0\.15\b|\b0\.005\b", text) == []


def test_shaders_get_their_macros() -> None:
    """Oracle: the values, and an error for a name that the header lacks."""
    source = "float a = GS_EPS2D; float b[5] = float[5](GS_SH_C2); // GS_EPS2D"
    found = glsl_defines(source)
    assert list(found) == ["GS_EPS2D", "GS_SH_C2"]
    assert found["GS_EPS2D"] == "0.3"
    assert tuple(map(float, found["GS_SH_C2"].split(","))) == c.SH_C2
    with pytest.raises(AttributeError, match="NO_SUCH"):
        glsl_defines("GS_NO_SUCH")

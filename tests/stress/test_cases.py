"""The cases of `gscore stress`: each has measurements within its tolerances."""

import json

import pytest

from gscore.commands import main
from gscore.raster import native_library
from gscore.stress import run_cases, select
from gscore.stress.case import CASES, EmptyTestError, Measure, case

ALL = select(full=True)


def each():
    """A parameter for every quick case and, where it matters, every instruction set; those between
    the widest and the narrowest are slow tests."""
    isas = native_library.available_isas()
    for one in select():
        for isa in isas if one.per_isa else [""]:
            marks = [pytest.mark.slow] if isa in isas[1:-1] else []
            yield pytest.param(one, isa, id=f"{one.key}-{isa}" if isa else one.key, marks=marks)


@pytest.mark.parametrize(("one", "isa"), list(each()))
def test_case(one, isa):
    """Oracle: named in the case's first line."""
    outcomes = run_cases([one], isas=[isa] if isa else [])
    assert outcomes
    bad = [o for o in outcomes if o.passed is False]
    assert not bad, "\n".join(f"{o.test}: {o.error} > {o.tolerance} {o.note}" for o in bad)


def test_all_thirty_six_are_there():
    """Oracle: the numbers 1 to 36."""
    assert {int(c.key[1:3]) for c in ALL} == set(range(1, 37))


@pytest.fixture
def invented():
    """Cases that fail in known ways, while a test runs."""
    before = list(CASES)

    @case("S97", "an error too large", per_isa=False, needs=())
    def _(full):
        return [Measure("this", 2, 1), Measure("that", 1.0, 1.0)]

    @case("S98", "an empty picture", per_isa=False, needs=())
    def _(full):
        raise EmptyTestError("nothing to see")

    @case("S99", "not a number", per_isa=False, needs=())
    def _(full):
        return [Measure("nan", float("nan"), 1.0), Measure("nan", 0.5, 1.0)]

    @case("S99b", "no measure", per_isa=False, needs=())
    def _(full):
        return []

    @case("S99c", "no package", per_isa=False, needs=("no_such_package",))
    def _(full):
        return []

    yield
    CASES[:] = before


def test_failures_fail(invented, capsys):
    """Oracle: the invented cases."""
    assert main(["stress", "--json", "--only", "S97", "--only", "S98", "--only", "S99"]) == 1
    rows = json.loads(capsys.readouterr().out)
    assert [(r["test"], r["passed"]) for r in rows] == [
        ("S97 an error too large: this", False),
        ("S97 an error too large: that", True),
        ("S98 an empty picture", False),
        ("S99 not a number: nan", False),
        ("S99b no measure", False),
        ("S99c no package", None),
    ]
    assert isinstance(rows[0]["error"], float)
    assert "nothing to see" in rows[2]["note"]
    assert rows[5]["note"] == "skipped: needs no_such_package"


def test_the_table(capsys):
    """Oracle: the help's promise."""
    assert main(["stress", "--only", "S17 ", "--isa", "scalar"]) == 0
    out = capsys.readouterr().out
    assert "scalar  S17 nothing to draw" in out
    assert out.splitlines()[-1] == "1 passed, 0 failed, 0 skipped"
    assert main(["stress", "--only", "S17 ", "--isa", "all", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [r["isa"] for r in rows] == native_library.available_isas()
    assert set(rows[0]) == {"test", "isa", "error", "tolerance", "passed", "note"}


def test_unknown_names_are_named(capsys):
    """Oracle: the messages."""
    assert main(["stress", "--only", "S77"]) == 2
    err = capsys.readouterr().err
    assert "S77" in err and all(case.name in err for case in select())
    assert main(["stress", "--isa", "vax"]) == 2
    assert "vax" in capsys.readouterr().err

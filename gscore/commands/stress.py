"""`gscore stress`: numerical errors of the native library on this machine."""

import argparse
import sys
from functools import partial

from ..errors import ConfigError
from ..raster import native_library
from ..stress import Outcome, run_cases, select
from .args.device_option import add_device_option, device_of
from .parser import add_option
from .terminal.output import print_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    option("--json", "JSON list on stdout, one object per test")
    option("--only NAME", "run only tests whose names contain this", action="append", default=[])
    option("--isa ISA", "instruction set; `all` runs each one available (the best)")
    add_device_option(parser, default="cpu")
    option("--full", "also run the long tests: five minutes to half an hour")


def run(args: argparse.Namespace) -> int:
    """Run the tests, print them, and return 1 if one failed."""
    if args.isa and args.device != "cpu":
        raise ConfigError("`--isa` is for the CPU; leave it out with `--device`.")
    device = device_of(args)
    before = native_library.isa()
    isas = native_library.available_isas() if args.isa == "all" else [args.isa or before]
    native_library.set_isa(isas[0])
    native_library.set_isa(before)
    cases = select(args.only, full=args.full)
    found: list[Outcome] = []

    def report(outcome: Outcome) -> None:
        found.append(outcome)
        if not args.json:
            sys.stdout.write(_line(outcome))
            sys.stdout.flush()

    if not args.json:
        sys.stdout.write(f"{'':8}{'error':>9} {'allowed':>9}  {'isa':8}test\n")
    run_cases(cases, isas=isas, device=device, full=args.full, report=report)
    failed = sum(o.passed is False for o in found)
    if args.json:
        print_json([o.to_dict() for o in found])
    else:
        skipped = sum(o.passed is None for o in found)
        passed = len(found) - failed - skipped
        sys.stdout.write(f"{passed} passed, {failed} failed, {skipped} skipped\n")
    return 1 if failed else 0


def _line(o: Outcome) -> str:
    isa = o.isa.partition(":")[0]  # the name of a graphics card is too long for the column
    if o.passed is None:
        return f"{'skipped':8}{'':9} {'':9}  {isa:8}{o.test}: {o.note.removeprefix('skipped: ')}\n"
    verdict = "ok" if o.passed else "FAILED"
    note = f"  ({o.note})" if o.note else ""
    return f"{verdict:8}{o.error:9.1e} {o.tolerance:9.1e}  {isa:8}{o.test}{note}\n"

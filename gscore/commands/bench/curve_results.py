"""Results of the curves of `gscore bench time-error`: results.json, updated after each one."""

import argparse
from collections.abc import Sequence
from typing import Any

from ..._version import __version__
from ...bench.time_error import Curve, curve_json, time_to_psnr
from ...bench.training import first_size
from ...events import strict_json
from ...io.files import atomic_write
from ...metrics.machine import machine
from ...raster import native_library
from .curve_plans import CapturePlan


class ResultsFile:
    """The results so far; docs/metrics.md describes the file."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._path = args.output / "results.json"
        self._captures: dict[str, dict[str, Any]] = {}
        self._content = {
            "gscore": __version__,
            "finished": False,
            "machine": machine(),
            "isa": native_library.isa(),
            "threads": args.threads or native_library.default_threads(),
            "seeds": args.seeds,
            "captures": self._captures,
        }

    def add_curves(self, plan: CapturePlan, curves: Sequence[Curve]) -> None:
        """Store all curves of a capture so far."""
        eval_views = plan.eval_views
        self._captures[plan.name] = {
            "judged_on": first_size(eval_views),
            "held_out": [eval_views.names[index] for index in eval_views.test],
            "curves": [curve_json(curve) for curve in curves],
            "time_to_psnr": time_to_psnr(curves),
        }
        self._write()

    def add_sizes(self, plan: CapturePlan, found: dict[str, Any]) -> None:
        """Store all sizes of a capture so far."""
        self._captures[plan.name]["sizes"] = found
        self._write()

    def finish(self) -> None:
        """Mark the results as complete."""
        self._content["finished"] = True
        self._write()

    def text(self) -> str:
        """The content of the file."""
        return strict_json(self._content)

    def _write(self) -> None:
        atomic_write(self._path, self.text().encode())

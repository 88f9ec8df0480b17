"""What the depth experiment trains: its arms, its tables, how large and how long."""

from dataclasses import dataclass
from typing import Any

ARMS: dict[str, list[str]] = {
    "none": [],
    "exact": ["--depths", "depths-exact", "--depth-mode", "on"],
    "mono": ["--depths", "depths-mono-{seed}", "--depth-mode", "on"],
    "mono-auto": ["--depths", "depths-mono-{seed}"],
    "stereo": ["--depths", "depths-stereo", "--depth-mode", "on"],
    "stereo-loss": [
        *("--depths", "depths-stereo", "--depth-mode", "on"),
        *("--depth-points", "0"),
    ],
    "stereo+full": [
        *("--depths", "depths-stereo", "--depth-mode", "on"),
        *("--depth-weight", "1"),
    ],
    "stereo-points": ["--stereo", "on"],
    "onnx": ["--depths", "depths-onnx", "--depth-mode", "on"],
    "drop": ["--drop-rate", "0.2"],
    "mono+drop": ["--depths", "depths-mono-{seed}", "--depth-mode", "on", "--drop-rate", "0.2"],
    "mono-loss": [
        *("--depths", "depths-mono-{seed}", "--depth-mode", "on"),
        *("--depth-points", "0"),
    ],
    "mono+falling": [
        *("--depths", "depths-mono-{seed}", "--depth-mode", "on"),
        *("--depth-weight", "0.3", "--depth-weight-final", "0.1"),
    ],
    "random": ["--background", "random"],
    "masked": ["--mask-mode", "composite"],
    "masked+alpha": ["--mask-mode", "composite", "--alpha-weight", "0.1"],
    "masked+black": ["--mask-mode", "composite", "--background", "black"],
    "masked+exact": [
        *("--mask-mode", "composite"),
        *("--depths", "depths-exact", "--depth-mode", "on"),
    ],
    "masked+mono": [
        *("--mask-mode", "composite"),
        *("--depths", "depths-mono-{seed}", "--depth-mode", "on"),
    ],
}
"""What is trained with: options of `gscore train`."""
SMALL = {"width": 120, "iterations": 500, "max_splats": 15_000}
"""A third of a preview, on photos of a third of its width: seconds a run."""
TABLES: dict[str, dict[str, Any]] = {
    "views": SMALL,
    "auto": SMALL | {"views": ["50"], "arms": ["none", "mono-auto"], "seeds": [0]},
    "switches": SMALL
    | {
        "views": ["6", "12"],
        "arms": [
            *("none", "drop", "random"),
            *("mono", "mono+drop", "mono-loss", "mono+falling"),
            *("stereo", "stereo-loss", "stereo+full", "stereo-points"),
            *("masked", "masked+alpha", "masked+black", "masked+mono"),
        ],
    },
    "real": {"captures": ["plush", "stone_horse"], "views": ["6", "12", "24", "all"]},
    "study": {
        # A plain training on that many photos takes 4,000 steps.
        "preset": "normal",
        "views": ["50"],
        "arms": [
            *("none", "stereo", "mono", "exact"),
            *("masked", "masked+mono", "masked+exact"),
        ],
        "width": 480,
        "iterations": 3000,
        "max_splats": 60_000,
        "sh_degree": 3,
    },
}
"""What is trained for each table of docs/experiments/2026-11-depth.md, if not a plain preview."""
REFERENCE = {
    "preset": "normal",
    "width": 400,
    "iterations": 3000,
    "max_splats": 80_000,
    "sh_degree": 2,
}
"""The training on all views that stands for the exact depth of real captures."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """How large and how long all trainings of a table are; 0 or None: as the preset has it."""

    preset: str
    width: int = 0
    iterations: int = 0
    max_splats: int = 0
    sh_degree: int | None = None
    threads: int

    def __str__(self) -> str:
        words = {"px": self.width, "steps": self.iterations, "splats": self.max_splats}
        given = [f"{value} {unit}" for unit, value in words.items() if value]
        given += [] if self.sh_degree is None else [f"SH degree {self.sh_degree}"]
        return ", ".join([self.preset, *given])

    @property
    def folder(self) -> str:
        return str(self).replace(", ", "-").replace(" ", "")

    @property
    def options(self) -> list[str]:
        given = {
            "--resolution": self.width,
            "--iterations": self.iterations,
            "--max-splats": self.max_splats,
        }
        found = ["--preset", self.preset, "--threads", str(self.threads)]
        for flag, value in given.items():
            found += [flag, str(value)] if value else []
        return found + ([] if self.sh_degree is None else ["--sh-degree", str(self.sh_degree)])

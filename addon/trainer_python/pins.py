"""Pinned packages of the training environment: versions, sizes and sources; no bpy.

The lists in the folder `pinned` are requirement files of pip, which `tools/build/renew_pins.py`
writes.
"""

import platform
import re
import sys
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).parent / "pinned"
REGISTRY = "https://pypi.org/simple"
"""Where packages with hashes come from, unless pip was set up to ask a mirror of it."""
TORCH_INDEX = "https://download.pytorch.org/whl/cpu"
"""Where torch without CUDA for Linux lies; elsewhere the registry's own has none."""

_PIN = re.compile(r"^([A-Za-z0-9][A-Za-z0-9._-]*)==([^\s;\\]+)", re.MULTILINE)
_SIZES = re.compile(r"^# megabytes: (.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Pins:
    """One list, installed by one call of pip from one place."""

    file: Path
    index: str

    @property
    def text(self) -> str:
        """As it stands in the file."""
        return self.file.read_text(encoding="utf-8")

    @property
    def hashed(self) -> bool:
        """Whether each file that pip may take is known by its SHA-256."""
        return "--hash=sha256:" in self.text

    @property
    def packages(self) -> list[str]:
        """Names and versions; one that depends on the version of Python stands there twice."""
        return [f"{name} {version}" for name, version in _PIN.findall(self.text)]

    @property
    def megabytes(self) -> int:
        """To download for this system, about; 0 if that is not known."""
        match = _SIZES.search(self.text)
        sizes = dict(item.split(" ") for item in match[1].split(", ")) if match else {}
        return int(sizes.get(system(), 0))


def system() -> str:
    """This system as sizes are listed."""
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    kind = {"win32": "windows", "darwin": "macos"}.get(sys.platform, "linux")
    return f"{kind}_{machine}"


def pip() -> Pins:
    """pip itself, which Pythons bring in versions too old to tell their progress."""
    return Pins(FOLDER / "pip.txt", REGISTRY)


def torch(*, cpu: bool) -> Pins:
    """torch, and on Linux the CUDA that the usual one needs.

    Args:
        cpu: Prefer the one without CUDA.
    """
    if cpu and sys.platform.startswith("linux"):
        return Pins(FOLDER / "torch-cpu.txt", TORCH_INDEX)
    return Pins(FOLDER / "torch.txt", REGISTRY)


def rest() -> Pins:
    """Everything else that training needs."""
    return Pins(FOLDER / "packages.txt", REGISTRY)

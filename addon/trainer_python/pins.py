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
"""Source of packages with hashes, unless pip is configured to use a mirror of it."""
TORCH_INDEX = "https://download.pytorch.org/whl/cpu"
"""Index of torch without CUDA for Linux; on other systems torch of the registry has no CUDA."""

_PIN = re.compile(r"^([A-Za-z0-9][A-Za-z0-9._-]*)==([^\s;\\]+)", re.MULTILINE)
_SIZES = re.compile(r"^# megabytes: (.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Pins:
    """One list, installed by one call of pip from one source."""

    file: Path
    index: str

    @property
    def text(self) -> str:
        """Content of the file."""
        return self.file.read_text(encoding="utf-8")

    @property
    def hashed(self) -> bool:
        """Whether every file is pinned by its SHA-256."""
        return "--hash=sha256:" in self.text

    @property
    def packages(self) -> list[str]:
        """Names and versions; a package that depends on the Python version occurs twice."""
        return [f"{name} {version}" for name, version in _PIN.findall(self.text)]

    @property
    def megabytes(self) -> int:
        """Approximate download size for this system, MB; 0: unknown."""
        match = _SIZES.search(self.text)
        sizes = dict(item.split(" ") for item in match[1].split(", ")) if match else {}
        return int(sizes.get(system(), 0))


def system() -> str:
    """Name of this system in the lists of sizes."""
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    kind = {"win32": "windows", "darwin": "macos"}.get(sys.platform, "linux")
    return f"{kind}_{machine}"


def pip() -> Pins:
    """pip itself, as Pythons bundle versions too old to report progress."""
    return Pins(FOLDER / "pip.txt", REGISTRY)


def torch(*, cpu: bool) -> Pins:
    """torch, on Linux with CUDA unless `cpu`.

    Args:
        cpu: Prefer torch without CUDA.
    """
    if cpu and sys.platform.startswith("linux"):
        return Pins(FOLDER / "torch-cpu.txt", TORCH_INDEX)
    return Pins(FOLDER / "torch.txt", REGISTRY)


def rest() -> Pins:
    """Everything else that training needs."""
    return Pins(FOLDER / "packages.txt", REGISTRY)

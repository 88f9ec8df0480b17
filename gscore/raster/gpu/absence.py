"""Absent devices: why this machine offers none, or none for a card, and what helps."""

import os
import sys
from collections.abc import Collection, Mapping
from pathlib import Path

_AUTO_ON = ("linux",)
"""Platforms (sys.platform) whose cards `auto` uses: on others no card has passed the tests yet."""
_AUTO_OFF = (
    "On this operating system no graphics card is chosen automatically, because none was tested "
    "yet; choose the card itself to use it."
)
_NO_CARD = "There is no graphics card."
_VENDORS = {
    0x10DE: (
        "NVIDIA",
        "install NVIDIA's driver with its Vulkan part (Debian, Ubuntu: libnvidia-gl-VERSION)",
    ),
    0x1002: ("AMD", "install Mesa's Vulkan drivers (Debian, Ubuntu: mesa-vulkan-drivers)"),
    0x8086: ("Intel", "install Mesa's Vulkan drivers (Debian, Ubuntu: mesa-vulkan-drivers)"),
}
"""Names of vendors of graphics cards, and where their Vulkan drivers come from."""
_VARIABLES = (
    "VK_DRIVER_FILES",
    "VK_ICD_FILENAMES",
    "VK_LOADER_DRIVERS_SELECT",
    "VK_LOADER_DRIVERS_DISABLE",
)
"""Environment variables that hide drivers from the Vulkan loader."""
_LOADERS = {"win32": "vulkan-1.dll", "darwin": "libvulkan.1.dylib"}


def may_have_card(root: Path = Path("/")) -> bool:
    """Whether Linux has a device file of a graphics driver for programs, without which Vulkan only
    offers software devices; no library is loaded.

    Args:
        root: Root of the file system.
    """
    devices = root / "dev"
    names = ("nvidiactl", "dxg")  # NVIDIA's driver, and WSL2's
    return any((devices / name).exists() for name in names) or any(devices.glob("dri/renderD*"))


def no_automatic_card() -> str:
    """Why `auto` is the CPU here without a search, as a sentence; empty: there may be a card."""
    if sys.platform not in _AUTO_ON:
        return _AUTO_OFF
    return "" if may_have_card() else _NO_CARD


def why_no_device(message: str, root: Path = Path("/")) -> tuple[str, ...]:
    """Sentences on a machine without any Vulkan device, the most specific first.

    Args:
        message: The library's message, without a full stop.
        root: Root of the file system.
    """
    if message.startswith("GSCORE_"):  # a setting of the user's
        return (f"{message}.",)
    if cards := cards_without_driver((), root):
        return cards
    where = _surroundings(root, os.environ)
    if "no Vulkan loader" in message:
        loader = _LOADERS.get(sys.platform, "libvulkan.so.1")
        return (f"There is no Vulkan loader ({loader}): {_loader_source()}. {where}".rstrip(),)
    what = f"There is a Vulkan loader, but no driver for a graphics card ({message})."
    return (f"{what} {where or 'Install the driver of the vendor of the card, or use the CPU.'}",)


def cards_without_driver(vendors: Collection[int], root: Path = Path("/")) -> tuple[str, ...]:
    """Sentences on graphics cards in this machine for which Vulkan has no driver.

    Args:
        vendors: PCI numbers of the vendors whose devices Vulkan offers.
        root: Root of the file system.
    """
    found = []
    for vendor in sorted(_cards(root) - set(vendors)):
        name, source = _VENDORS[vendor]
        remedy = _surroundings(root, os.environ) or f"{source[:1].upper()}{source[1:]}."
        found.append(f"There is a graphics card of {name} without a Vulkan driver. {remedy}")
    return tuple(found)


def _cards(root: Path) -> set[int]:
    """PCI numbers of known vendors of the graphics cards that Linux lists."""
    if sys.platform != "linux":
        return set()
    found = {0x10DE} if (root / "proc/driver/nvidia/version").exists() else set()
    for path in (root / "sys/class/drm").glob("card*/device/vendor"):
        try:
            found.add(int(path.read_text(encoding="ascii"), 16))
        except (OSError, ValueError):
            continue
    return found & _VENDORS.keys()


def _surroundings(root: Path, environ: Mapping[str, str]) -> str:
    """A sentence on a variable, WSL2, a sandbox or a container that hides graphics cards; empty:
    none."""
    if name := next((name for name in _VARIABLES if environ.get(name)), ""):
        return (
            f"The environment variable {name}={environ[name][:100]} limits Vulkan's drivers: unset "
            "it, or add the driver of the card."
        )
    if sys.platform != "linux":
        return ""
    if environ.get("FLATPAK_ID") or (root / ".flatpak-info").exists():
        return (
            "This is a Flatpak, which sees only the drivers of its runtime: update it (`flatpak "
            "update`), or install Blender from blender.org."
        )
    if environ.get("SNAP"):
        return (
            "This is a Snap, which may see no Vulkan driver: connect its graphics interface, or "
            "install Blender from blender.org."
        )
    if "microsoft" in _first_line(root / "proc/version").lower():
        return (
            "This is WSL2, whose Linux usually has no Vulkan driver for the card: run gscore in "
            "Windows itself."
        )
    if environ.get("NVIDIA_VISIBLE_DEVICES", "void") not in ("", "void", "none"):
        capabilities = environ.get("NVIDIA_DRIVER_CAPABILITIES", "")
        if not {"all", "graphics"} & set(capabilities.split(",")):
            return (
                "This container has NVIDIA's driver without its graphics part: start it with "
                "NVIDIA_DRIVER_CAPABILITIES=all."
            )
    if any((root / name).exists() for name in (".dockerenv", "run/.containerenv")):
        return (
            "This is a container without a graphics card: give it one (for NVIDIA all "
            "gpus and NVIDIA_DRIVER_CAPABILITIES=all, for AMD and Intel the device /dev/dri; "
            "docs/gpu.md has Docker's options) and install a Vulkan driver in it."
        )
    return ""


def _first_line(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").partition("\n")[0]
    except OSError:
        return ""


def _loader_source() -> str:
    if sys.platform == "win32":
        return "install the driver of the graphics card from its vendor"
    if sys.platform == "darwin":
        return "macOS has none of its own, and this build of gscore contains no MoltenVK"
    return "install it (Debian, Ubuntu: libvulkan1; Fedora: vulkan-loader)"

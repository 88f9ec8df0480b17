"""List of devices, and sentences on missing ones."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gscore.raster.gpu import absence, denied, library
from gscore.raster.gpu.devices import find_devices
from gscore.raster.gpu.verdict import DeviceVerdict, keep_verdict
from tests.gpu.fake_gpu import AMD, NVIDIA, SOFTWARE, card

ROOT = Path(__file__).parents[2]


def test_devices_have_the_facts_of_the_library(fake) -> None:
    """Oracle: the struct's fields as the fake library fills them."""
    fake(card(), card(**SOFTWARE, memory_free=0))
    first, second = find_devices().devices
    assert (first.number, first.name, first.kind, first.api_version) == (
        *(0, "Card", "discrete"),
        "1.3.230",
    )
    assert first.uuid == bytes(range(16)).hex() and first.memory_free_bytes == 20_000_000_000
    assert not first.reason and first.verdict is None
    assert second.number == 1 and second.is_software and second.memory_free_bytes is None
    assert second.to_dict()["reason"] == ""


def test_a_device_that_lacks_something_names_it(fake) -> None:
    """Oracle: the library's list of missing features, and the remedy."""
    fake(card(missing=b"Vulkan 1.2, buffer addresses"))
    device = find_devices().devices[0]
    assert device.missing == ("Vulkan 1.2", "buffer addresses")
    assert "It lacks Vulkan 1.2, buffer addresses; update its driver" in device.reason


def test_denied_drivers_are_not_used(fake, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: a rule for one vendor, a range of devices and drivers, and a system."""
    rule = denied.DeniedDriver(
        vendor=NVIDIA, devices=(0x2200, 0x22FF), drivers=(5, 9), reason="Pictures are black."
    )
    monkeypatch.setattr(denied, "DENIED", (rule,))
    fake(card(), card(vendor=AMD), card(device=0x2300), card(driver_version=10))
    found = find_devices().devices
    assert [bool(one.reason) for one in found] == [True, False, False, False]
    assert found[0].reason == "This driver is denied: Pictures are black."
    elsewhere = denied.DeniedDriver(vendor=NVIDIA, system="another", reason="x")
    monkeypatch.setattr(denied, "DENIED", (elsewhere,))
    assert denied.denied_reason(NVIDIA, 1, 1) == ""


def test_a_failed_self_test_is_the_reason(fake) -> None:
    """Oracle: the first problem of the verdict, and the command that repeats the test."""
    fake(card())
    device = find_devices().devices[0]
    keep_verdict(
        device.key, DeviceVerdict(passed=False, problems=("rgb differs.", "alpha differs"))
    )
    assert device.reason == (
        "Its self-test failed: rgb differs. `gscore doctor --verify` repeats it."
    )


def test_a_missing_library_is_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: no devices, and a sentence with the path that was tried."""
    monkeypatch.setenv("GSCORE_GPU_LIBRARY", "/nowhere/libgscore_gpu.so")
    monkeypatch.setattr(library.LIBRARY, "loaded", None)
    found = find_devices()
    assert found.devices == ()
    assert "/nowhere/libgscore_gpu.so (GSCORE_GPU_LIBRARY) cannot be opened" in found.problems[0]


VARIABLES = (
    *("VK_DRIVER_FILES", "VK_ICD_FILENAMES"),
    *("VK_LOADER_DRIVERS_SELECT", "VK_LOADER_DRIVERS_DISABLE"),
)
"""Those of the Vulkan loader that hide drivers."""
linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux lists its cards in files")


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Root of a machine outside of any container, with no card."""
    surroundings = "FLATPAK_ID", "SNAP", "NVIDIA_VISIBLE_DEVICES", "NVIDIA_DRIVER_CAPABILITIES"
    for name in (*surroundings, *VARIABLES):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "root"


def _put(root: Path, name: str, text: str = "") -> None:
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def test_a_missing_loader_is_named(plain: Path) -> None:
    """Oracle: the message of the library, and what to install."""
    (sentence,) = absence.why_no_device("there is no Vulkan loader on this system", plain)
    assert sentence.startswith("There is no Vulkan loader (") and "install" in sentence


def test_a_loader_without_driver_is_named(plain: Path) -> None:
    """Oracle: the library's message inside the sentence."""
    (sentence,) = absence.why_no_device("the Vulkan loader finds no driver", plain)
    assert "no driver for a graphics card (the Vulkan loader finds no driver)" in sentence


def test_settings_of_the_user_are_named_first(plain: Path) -> None:
    """Oracle: the library's message alone."""
    message = "GSCORE_VULKAN_LOADER is no Vulkan library: /x"
    assert absence.why_no_device(message, plain) == (f"{message}.",)


@linux
@pytest.mark.parametrize(
    ("files", "variables", "words"),
    [
        ({"proc/version": "Linux 5.15 microsoft-standard-WSL2"}, {}, "This is WSL2"),
        ({".dockerenv": ""}, {}, "This is a container without a graphics card"),
        ({"run/.containerenv": ""}, {}, "This is a container without a graphics card"),
        ({}, {"FLATPAK_ID": "org.blender.Blender"}, "This is a Flatpak"),
        ({}, {"SNAP": "/snap/blender"}, "This is a Snap"),
        *(({".dockerenv": ""}, {name: "/x.json"}, f"{name}=/x.json limits") for name in VARIABLES),
        (
            {".dockerenv": ""},
            {"NVIDIA_VISIBLE_DEVICES": "all", "NVIDIA_DRIVER_CAPABILITIES": "compute,utility"},
            "NVIDIA_DRIVER_CAPABILITIES=all",
        ),
    ],
)
def test_surroundings_that_hide_cards_are_named(
    plain: Path, monkeypatch: pytest.MonkeyPatch, files, variables, words: str
) -> None:
    """Oracle: the files and variables by which such surroundings are known; variables of Vulkan are
    named first."""
    for name, text in files.items():
        _put(plain, name, text)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert words in absence.why_no_device("the Vulkan loader finds no driver", plain)[0]


@linux
def test_a_card_without_driver_is_named(plain: Path) -> None:
    """Oracle: the vendors' PCI numbers in files as Linux has them."""
    _put(plain, "sys/class/drm/card0/device/vendor", "0x1002\n")
    _put(plain, "sys/class/drm/card1/device/vendor", "0x1af4\n")
    (sentence,) = absence.cards_without_driver((), plain)
    assert "graphics card of AMD without a Vulkan driver" in sentence
    assert "mesa-vulkan-drivers" in sentence
    assert absence.cards_without_driver({AMD}, plain) == ()
    _put(plain, "proc/driver/nvidia/version", "NVRM")
    assert "NVIDIA" in absence.cards_without_driver({AMD}, plain)[0]


def test_drawing_on_the_cpu_loads_no_vulkan() -> None:
    """Oracle: the modules and mapped files of a fresh process that has drawn."""
    code = (
        "import sys, numpy as np, gscore\n"
        "f = lambda *s: np.ones(s, np.float32)\n"
        "p = gscore.Splats(means=f(1, 3), quats=f(1, 4), scales=f(1, 3), opacities=f(1),\n"
        "    sh0=f(1, 1, 3), shN=f(1, 0, 3))\n"
        "gscore.render(p, np.diag([9.0, 9.0, 1.0]), np.eye(4), 4, 4)\n"
        "gpu = [name for name in sys.modules if name.startswith('gscore.raster.gpu.')]\n"
        "maps = open('/proc/self/maps').read() if sys.platform == 'linux' else ''\n"
        "print(gpu, 'vulkan' in maps, 'gscore_gpu' in maps)"
    )
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=env
    )
    assert done.stdout.strip() == "['gscore.raster.gpu.absence'] False False"

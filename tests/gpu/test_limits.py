"""Pictures and models at the limits of a device; oracles: the CPU's pictures, and sentences."""

import json
import shutil
import sys
from pathlib import Path

import pytest

from gscore.raster.gpu.library import library_path
from tests.gpu.drivers import DRIVERS, Driver, each_driver, result_of, variables_of

ONE, OTHER = DRIVERS[1], DRIVERS[-1]
TOLERANCE = 1e-4


@pytest.mark.slow
def test_a_picture_of_8k() -> None:
    """Oracle: the CPU's within 3e-5, as positions up to 7680 px have steps of 5e-4 px in float32; a
    few pixels differ where rounding decides whether a splat is visible."""
    found = result_of(ONE, "print_large_picture()")
    assert found["different"] < 1e-6 and found["drawn"] > 0.5


@each_driver
def test_rows_with_nan_are_not_drawn(driver: Driver) -> None:
    """Oracle: the CPU's picture, and radii of 0."""
    found = result_of(driver, "print_rows_with_nan()")
    assert found["difference"] < 1e-5
    assert not any(found["damaged"]) and len(found["damaged"]) == 33 and found["others"] > 10


def test_a_small_memory_is_a_sentence() -> None:
    """Oracle: 256 MiB, of which a model of 1.3 million splats needs 299 and six of 200,000 need 46
    each: the error and its remedy, the CPU's picture of a smaller one, each kept model copied once,
    and the CPU where it may continue."""
    found = result_of(ONE, "print_small_memory()", GSCORE_GPU_MEMORY="256")
    kind, sentence = found["error"]
    assert kind == "DeviceMemoryError" and "MiB more (GSCORE_GPU_MEMORY)" in sentence
    assert "`gscore convert --count`" in sentence
    assert found["difference"] < TOLERANCE
    assert found["uploads"] == 6 and found["name"] == "cpu"


_NAMES = """
import json
from gscore.raster.gpu.devices import find_devices
found = find_devices()
print(json.dumps([[device.name for device in found.devices], list(found.problems)]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="messages and folders are Linux's")
def test_a_loader_that_cannot_be_opened_is_a_reason(tmp_path: Path) -> None:
    """Oracle: the system's reasons for a missing file, a text, and another library."""
    (tmp_path / "text.so").write_text("text")
    math = next(Path("/").glob("lib*/**/libm.so.6"))
    for path, words in (
        (tmp_path / "none.so", "No such file or directory"),
        (tmp_path / "text.so", "file too short"),
        (math, "it has no vkGetInstanceProcAddr"),
    ):
        names, problems = result_of(ONE, _NAMES, GSCORE_VULKAN_LOADER=str(path))
        assert names == [] and problems[0].startswith("GSCORE_VULKAN_LOADER is no Vulkan library:")
        assert words in problems[0] and str(path) in problems[0]


@pytest.mark.skipif(sys.platform != "linux", reason="stands for macOS")
def test_a_loader_without_a_driver_leaves_the_bundled_one(tmp_path: Path) -> None:
    """Oracle: SwiftShader in MoltenVK's place next to the library, with and without it."""
    library = shutil.copy(library_path(), tmp_path)
    hidden = {"VK_DRIVER_FILES": "/none.json", "VK_ICD_FILENAMES": "/none.json"}
    hidden["GSCORE_GPU_LIBRARY"] = str(library)
    names, problems = result_of(ONE, _NAMES, **hidden)
    assert names == [] and "VK_DRIVER_FILES=/none.json limits Vulkan's drivers" in problems[0]
    driver = variables_of(OTHER)["GSCORE_VULKAN_LOADER"]
    (tmp_path / "libMoltenVK.dylib").symlink_to(driver)
    names, _ = result_of(ONE, _NAMES, **hidden)
    assert len(names) == 1 and "SwiftShader" in names[0]


def test_two_devices_draw_at_once(tmp_path: Path) -> None:
    """Oracle: the names of two drivers of one loader, and the CPU's picture from each."""
    icd = {"library_path": variables_of(OTHER)["GSCORE_VULKAN_LOADER"], "api_version": "1.3.0"}
    manifest = tmp_path / "other.json"
    manifest.write_text(json.dumps({"file_format_version": "1.0.0", "ICD": icd}), encoding="utf-8")
    found = result_of(ONE, "print_all_devices()", VK_ADD_DRIVER_FILES=str(manifest))
    assert len(found) == 2 and any("SwiftShader" in name for name in found)
    assert max(found.values()) < TOLERANCE

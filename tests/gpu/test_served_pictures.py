"""Pictures of a graphics card by a render server, as Blender gets them."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gscore import BackendError
from gscore.raster.gpu import verdict
from gscore.raster.gpu.devices import Device
from gscore.raster.gpu.verdict import DeviceVerdict, keep_verdict
from gscore.raster.render_client import RenderClient, find_devices
from gscore.raster.render_messages import NoDeviceError, RenderServerError
from tests.raster.render_clients import drawn, same, splats_of

TOLERANCE = 2e-5


@pytest.fixture
def client(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[RenderClient]:
    """A client of a server that draws on the device, whose verdict it finds."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(verdict, "cache_folder", lambda: tmp_path / "gscore" / "gpu")
    keep_verdict(device.key, DeviceVerdict(passed=True))
    made = RenderClient(device.uuid, folder=str(tmp_path))
    yield made
    made.close()


def test_pictures_are_those_of_the_cpu(client: RenderClient) -> None:
    """Oracle: the CPU's pictures within the tolerance; the same bits in a window and a second
    time; the number of sent arrays."""
    splats = splats_of()
    whole = drawn(splats, device=client)
    far = np.full((64, 85), 4, np.float32)
    far[::3] = np.nan
    ways: list[dict[str, Any]] = [{}, {"far_depths": far}, {"orthographic": True}]
    for how in ways:
        found, wanted = drawn(splats, device=client, **how), drawn(splats, **how)
        for name in ("rgb", "alpha", "inverse_depth", "depth"):
            np.testing.assert_allclose(
                getattr(found, name), getattr(wanted, name), atol=TOLERANCE, rtol=TOLERANCE
            )
    assert same(drawn(splats, device=client), whole)
    part = drawn(splats, device=client, window=(20, 10, 50, 30))
    assert np.array_equal(part.rgb, whole.rgb[10:40, 20:70])
    assert client.sent == 6 and client.started == 1


def test_normals_are_those_of_the_cpu(client: RenderClient) -> None:
    """Oracle: the CPU's normals, where normals of a pixel do not cancel; the picture beside them
    has the bits that it has alone."""
    splats = splats_of()
    for how in ({}, {"orthographic": True}):
        found = drawn(splats, device=client, normals=True, **how)
        wanted = drawn(splats, normals=True, **how)
        solid = wanted.alpha > 0.1
        error = np.abs(found.normal - wanted.normal)[solid]
        assert solid.mean() > 0.1 and np.quantile(error, 0.99) < 10 * TOLERANCE
        np.testing.assert_array_equal(found.rgb, drawn(splats, device=client, **how).rgb)


@pytest.mark.parametrize("fault", ["lost", "oom", "hang"])
def test_a_failed_device_is_an_error(
    client: RenderClient, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    """Oracle: an injected fault; a new server draws the next picture."""
    monkeypatch.setenv("GSCORE_GPU_FAULT", f"{fault}:2")
    splats = splats_of()
    first = drawn(splats, device=client)
    with pytest.raises(RenderServerError, match=r"GSCORE_GPU_FAULT|did not finish"):
        drawn(splats, device=client)
    assert same(drawn(splats, device=client), first)
    assert client.started == 2


def test_a_device_that_failed_its_test_is_not_used(client: RenderClient, device: Device) -> None:
    """Oracle: the sentence of its verdict."""
    keep_verdict(device.key, DeviceVerdict(passed=False, problems=("wrong pictures",)))
    with pytest.raises(RenderServerError, match=r"is not used\. Its self-test failed: wrong"):
        drawn(splats_of(), device=client)


def test_automatic_takes_no_software_device(client: RenderClient, device: Device) -> None:
    """Oracle: the kind of the devices."""
    if not device.is_software:
        pytest.skip("There is a graphics card.")
    with pytest.raises(NoDeviceError, match=r"^The CPU is used\. "):
        drawn(splats_of(), device=RenderClient("auto"))


def test_devices_are_listed_by_another_process(client: RenderClient, device: Device) -> None:
    """Oracle: the list of this process."""
    found, problems = find_devices()
    assert {"uuid": device.uuid, "name": device.name, "reason": ""} in found
    assert all(isinstance(problem, str) for problem in problems)


def test_a_machine_without_vulkan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: a sentence instead of devices, and an error of a picture."""
    monkeypatch.setenv("GSCORE_VULKAN_LOADER", os.fspath(tmp_path / "none.so"))
    found, problems = find_devices()
    assert found == [] and len(problems) == 1 and "GSCORE_VULKAN_LOADER" in problems[0]
    with pytest.raises(BackendError, match="not in this computer"):
        drawn(splats_of(), device=RenderClient("ab" * 16))
    with pytest.raises(NoDeviceError, match=r"^The CPU is used\. "):
        drawn(splats_of(), device=RenderClient("auto"))

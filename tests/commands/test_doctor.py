"""gscore doctor: a healthy machine, and each kind of problem."""

import getpass
import json
import platform
import re
import sys

import numpy as np
import pytest

from gscore.commands import doctor, gpu_report
from gscore.errors import BackendError
from gscore.raster import api, native_library


def test_a_machine_that_can_train(gscore):
    """Oracle: this machine, which runs the tests."""
    code, out, _ = gscore("doctor", "--json")
    facts = json.loads(out)
    assert code == 0 and facts["can_train"] and facts["missing"] == []
    native = facts["native"]
    assert native["isa"] in native["isas"] and "scalar" in native["isas"]
    assert set(native["self_test"]) == set(native["isas"])
    assert all(found["error"] < 1e-5 for found in native["self_test"].values())
    assert native["threads"] >= 1 and facts["packages"]["torch"]["version"]
    assert facts["memory_bytes"] > 0
    assert facts["install"] == ""
    code, out, _ = gscore("doctor")
    assert code == 0 and "This machine can train." in out and "scalar: ok" in out
    assert "pip install" not in out


def test_the_instruction_set_is_put_back():
    """Oracle: the previous one."""
    before = native_library.isa()
    doctor.self_test(native_library.available_isas())
    assert native_library.isa() == before


def test_self_test_sees_a_wrong_picture(monkeypatch):
    """Oracle: a rasterizer with an error of one part in a thousand."""
    true_render = api.render

    def wrong(*args, **options):
        rendered = true_render(*args, **options)
        rendered.rgb[...] *= np.float32(1.001)
        return rendered

    monkeypatch.setattr(api, "render", wrong)
    assert doctor.self_test(["scalar"])["scalar"]["error"] > 5e-4


def test_wrong_pictures_mean_no_training(gscore, monkeypatch):
    """Oracle: exit code 2 and the word."""
    found = {native_library.isa(): {"error": 0.3, "milliseconds": 1.0}}
    monkeypatch.setattr(doctor, "self_test", lambda isas: found)
    code, out, _ = gscore("doctor")
    assert code == 2 and "WRONG" in out and "cannot train" in out


@pytest.mark.parametrize(
    ("package", "trains"), [("torch", False), ("pycolmap", True), ("onnxruntime", True)]
)
def test_missing_packages(gscore, monkeypatch, package, trains):
    """Oracle: a None in sys.modules, which makes the import fail; only packages for training are
    fatal."""
    monkeypatch.setitem(sys.modules, package, None)
    code, out, _ = gscore("doctor", "--json")
    facts = json.loads(out)
    assert code == (0 if trains else 2) and facts["can_train"] is trains
    assert facts["packages"][package]["problem"] == "not installed"
    assert bool(facts["missing"]) is not trains


def test_packages_of_few_users_are_optional(gscore, monkeypatch):
    """Oracle: a missing bpy is marked, a missing av is offered by the command instead."""
    for package in ("bpy", "av"):
        monkeypatch.setitem(sys.modules, package, None)
    rows = gscore("doctor")[1].splitlines()
    bpy, av = (next(row for row in rows if row.startswith(name)) for name in ("bpy ", "av "))
    assert "not installed, optional" in bpy and "optional" not in av


def test_the_whole_command_stands_there_once(gscore, monkeypatch):
    """Oracle: packages of two extras and bpy missing: one command, torch without CUDA."""
    for package in ("torch", "scipy", "PIL", "av", "bpy"):
        monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setattr(sys, "platform", "linux")
    command = (
        'pip install "gscore[train,video]" --extra-index-url https://download.pytorch.org/whl/cpu'
    )
    code, out, _ = gscore("doctor")
    assert code == 2 and out.count("pip install") == 1
    assert f"To install missing packages: {command}\n" in out
    _, out, _ = gscore("doctor", "--json")
    assert json.loads(out)["install"] == command


def test_a_package_that_does_not_load(gscore, monkeypatch, tmp_path):
    """Oracle: a torch that fails like one with a missing system library."""
    (tmp_path / "torch.py").write_text("raise OSError('libgomp.so.1: cannot open')\n")
    monkeypatch.delitem(sys.modules, "torch", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    code, out, _ = gscore("doctor")
    assert code == 2 and "does not load: libgomp.so.1" in out


def test_missing_library(gscore, monkeypatch, tmp_path):
    """Oracle: the sentence of the loader, exit code 2, and the rest of the report."""

    def missing():
        raise BackendError("The native library is missing: x.so does not exist.")

    monkeypatch.setattr(native_library, "available_isas", missing)
    code, out, _ = gscore("doctor")
    assert code == 2 and "native library is missing" in out and "numpy" in out


def test_report_on_the_graphics_cards(gscore, tmp_path, monkeypatch):
    """Oracle: the devices that doctor lists, and the kernels of pictures, gradients and steps; no
    paths, names or values of variables."""
    monkeypatch.setenv("VK_LAYER_PATH", "/home/somebody/secret")
    path = tmp_path / "new" / "report.json"
    code, out, _ = gscore("doctor", "--gpu-report", str(path), "--json")
    assert code == 0 and json.loads(out)["gpu_report"] == str(path)
    text = path.read_text()
    found, listed = json.loads(text), json.loads(out)["devices"]
    assert [one["name"] for one in found["devices"]] == [one["name"] for one in listed]
    assert "VK_LAYER_PATH" in found["variables"]
    private = ("secret", "home", str(tmp_path), sys.executable, platform.node(), getpass.getuser())
    words = text.replace(found["platform"], "")
    assert not [one for one in private if re.search(rf"\b{re.escape(one)}\b", words)]
    for device in found["devices"]:
        assert "uuid" not in device and device["workgroup"] >= 128
        if device["reason"]:
            assert device["times"] == [] and device["times_problem"] == device["reason"]
            continue
        assert device["verdict"]["passed"] and device["times_problem"] == ""
        times = device["times"][0]
        assert {"project", "blend", "blend_backward"} <= times["kernels_ms"].keys()
        assert {"loss_gradient", "blend", "learn"} <= times["step_kernels_ms"].keys()
    if not found["devices"]:
        assert found["problems"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "The library /home/ann/my py/gscore/lib.so has version 2.",
            "The library lib.so has version 2.",
        ),
        (r"cannot load C:\Users\ANN~1\gs\gscore_gpu.dll: 126", "cannot load gscore_gpu.dll: 126"),
        ("/usr/share/vulkan/icd.d/a.json, /etc/b.json", "a.json, b.json"),
        ("60 steps/s, 1/2, NVIDIA/AMD", "60 steps/s, 1/2, NVIDIA/AMD"),
    ],
)
def test_reports_have_no_paths(text, expected):
    """Oracle: the names of the files alone, and texts without paths."""
    assert gpu_report._without_paths({"a": [text, 1, None]}) == {"a": [expected, 1, None]}


def test_report_that_cannot_be_written(gscore, tmp_path):
    """Oracle: exit code 2 and the path, before any test."""
    (tmp_path / "file").write_text("")
    code, _, err = gscore("doctor", "--gpu-report", str(tmp_path / "file" / "report.json"))
    assert code == 2 and "file" in err

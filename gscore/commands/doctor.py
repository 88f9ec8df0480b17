"""`gscore doctor`: capabilities of this machine, and missing packages."""

import argparse
import importlib
import json
import platform
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .._version import __version__
from ..errors import GsError
from ..extras import install_hint
from ..io.files import atomic_write
from ..io.system_memory import available_memory_bytes, total_memory_bytes
from ..metrics.machine import cores, cpu_name, version_of
from ..raster.gpu.devices import NOT_TESTED, FoundDevices, find_devices
from ..raster.gpu.verification import verified
from ..sh import rgb_to_sh0
from ..shared_constants import ALPHA_MIN, EPS2D
from ..splats import Splats
from ..text_format import count_text, size_text
from .args.device_option import test_report
from .gpu_report import device_report
from .parser import add_option
from .terminal.output import check_folder, print_result
from .terminal.status import Status, show_while

_LITTLE_MEMORY = 2_000_000_000
_TOLERANCE = 1e-5
_ABSENT = "not installed"


@dataclass(frozen=True)
class _Part:
    """A package that a verb needs."""

    module: str
    distribution: str
    use: str
    needed: bool
    """Whether training needs it."""
    offered: bool = True
    """Whether the install command includes it if missing: few users need the packages with an extra
    of their own, and bpy supports one Python version only."""


_PARTS = (
    _Part("numpy", "numpy", "required by all verbs", True),
    _Part("plyfile", "plyfile", "reading models", True),
    _Part("torch", "torch", "training", True),
    _Part("scipy", "scipy", "initial sizes of splats, SSIM", True),
    _Part("PIL", "pillow", "reading photos", True),
    _Part("safetensors", "safetensors", "checkpoints", True),
    _Part("pycolmap", "pycolmap", "finding cameras of photos", False),
    _Part("onnxruntime", "onnxruntime", "LPIPS, depth networks", False),
    _Part("OpenEXR", "OpenEXR", "depth maps in OpenEXR files", False),
    _Part("av", "av", "MP4 files", False),
    _Part("zstandard", "zstandard", "SPZ files of version 4", False),
    _Part("huggingface_hub", "huggingface_hub", "downloads of depth networks", False),
    _Part("skimage", "scikit-image", "meshes", False),
    _Part("fast_simplification", "fast-simplification", "meshes", False),
    _Part("xatlas", "xatlas", "textures of meshes; extra texture", False, offered=False),
    _Part("pillow_heif", "pillow-heif", "HEIC photos; extra heic", False, offered=False),
    _Part("rawpy", "rawpy", "raw photos; extra raw", False, offered=False),
    _Part("pxr", "usd-core", "USD files; extra usd", False, offered=False),
    _Part("lpips", "lpips", "LPIPS as in papers; extra lpips-torch", False, offered=False),
    _Part("bpy", "bpy", "Blender scripts without a window; extra blender", False, offered=False),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    option("--json", "one JSON object on stdout")
    option("--verify", "test the graphics cards again, up to a minute each")
    text = "write limits, self-tests and kernel times of the graphics cards, without private data"
    option("--gpu-report FILE.json", text, Path)


def run(args: argparse.Namespace) -> int:
    """Check and print; exit code 0 if this machine can train, 2 if a required part is missing."""
    with show_while(sys.stderr, "Checking the packages"):
        facts = _facts()
    if args.gpu_report:
        check_folder(args.gpu_report.parent)
    found = find_devices()
    facts |= _graphics_facts(found, verify=args.verify)
    if args.gpu_report:
        _write_report(args.gpu_report, found, facts)
        facts["gpu_report"] = str(args.gpu_report)
    print_result(facts, [_text(facts)], json=args.json)
    return 0 if facts["can_train"] else 2


def _facts() -> dict[str, Any]:
    native = _native_facts()
    packages = {part.distribution: _package_facts(part) for part in _PARTS}
    missing = [p.distribution for p in _PARTS if p.needed and packages[p.distribution]["problem"]]
    if native["problem"]:
        missing.insert(0, "the native library")
    absent = [
        p.module for p in _PARTS if p.offered and packages[p.distribution]["problem"] == _ABSENT
    ]
    available = available_memory_bytes()
    return {
        "gscore": __version__,
        "python": platform.python_version(),
        "executable": sys.executable,
        "platform": platform.platform(),
        "cpu": cpu_name(),
        "arch": platform.machine(),
        "cores": cores(),
        "memory_bytes": total_memory_bytes(),
        "memory_available_bytes": available,
        "memory_is_short": available is not None and available < _LITTLE_MEMORY,
        "native": native,
        "packages": packages,
        "can_train": not missing,
        "missing": missing,
        "install": install_hint(*absent),
    }


def _package_facts(part: _Part) -> dict[str, Any]:
    """Version of a package by importing it: an installed package may still fail to load."""
    try:
        module = importlib.import_module(part.module)
    except ModuleNotFoundError:
        return {"version": None, "use": part.use, "problem": _ABSENT}
    except Exception as error:  # a broken wheel may raise anything while it loads
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        return {
            "version": version_of(part.distribution),
            "use": part.use,
            "problem": f"does not load: {reason}",
        }
    version = getattr(module, "__version__", None) or version_of(part.distribution)
    return {"version": str(version), "use": part.use, "problem": ""}


def _native_facts() -> dict[str, Any]:
    """The native library: path, instruction sets, threads, and the self-test of one splat."""
    from ..raster import native_library

    facts: dict[str, Any] = {"library": str(native_library.library_path()), "problem": ""}
    try:
        facts["isas"] = native_library.available_isas()
        facts["isa"] = native_library.isa()
        facts["threads"] = native_library.default_threads()
        facts["self_test"] = self_test(facts["isas"])
    except GsError as error:
        return facts | {"problem": str(error)}
    wrong = [isa for isa, found in facts["self_test"].items() if not found["error"] <= _TOLERANCE]
    if facts["isa"] in wrong:
        facts["problem"] = f"wrong pictures with {facts['isa']}"
    return facts


def _write_report(path: Path, found: FoundDevices, machine: dict[str, Any]) -> None:
    """Test the devices that are new, measure them, and write the report."""
    with Status(sys.stderr) as status:
        for device in found.devices:
            if not device.unusable:
                verified(device, report=test_report(status))
        content = device_report(found, machine, progress=lambda sentence: status.show([sentence]))
    text = json.dumps(content, indent=2, allow_nan=False)
    atomic_write(path, f"{text}\n".encode())


def _graphics_facts(found: FoundDevices, *, verify: bool) -> dict[str, Any]:
    """The devices for drawing, tested again if `verify`, and why others are missing."""
    if verify:
        with Status(sys.stderr) as status:
            report = test_report(status)
            for device in found.devices:
                if not device.unusable:
                    verified(device, report=report, again=True)
    return {
        "devices": [device.to_dict() for device in found.devices],
        "device_problems": list(found.problems),
    }


def self_test(isas: list[str]) -> dict[str, dict[str, float]]:
    """Render one splat with each instruction set and compare it with the closed form.

    Returns:
        For each instruction set the largest absolute error of colour and alpha, and milliseconds.
    """
    from ..raster import native_library
    from ..raster.api import render

    size, focal, z, sigma, opacity = 65, 80.0, 4.0, 0.5, 0.8
    color, background = np.array([0.9, 0.3, 0.1]), np.array([0.1, 0.2, 0.4])
    splats = Splats(
        means=np.array([[0, 0, z]], np.float32),
        quats=np.array([[1, 0, 0, 0]], np.float32),
        scales=np.full((1, 3), np.log(sigma), np.float32),
        opacities=np.array([np.log(opacity / (1 - opacity))], np.float32),
        sh0=rgb_to_sh0(color)[None, None].astype(np.float32),
        shN=np.zeros((1, 0, 3), np.float32),
    )
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    offsets = np.arange(size) + 0.5 - size / 2
    square = offsets[:, None] ** 2 + offsets[None, :] ** 2
    alpha = opacity * np.exp(-square / (2 * ((focal * sigma / z) ** 2 + EPS2D)))
    alpha[alpha < ALPHA_MIN] = 0.0
    # At the cutoff rounding decides between 1/255 and zero; that is not an error.
    certain = np.abs(alpha * 255 - 1) > 1e-3
    expected = alpha[..., None] * color + (1 - alpha[..., None]) * background
    before, results = native_library.isa(), {}
    try:
        for isa in isas:
            native_library.set_isa(isa)
            began = time.perf_counter()
            picture = render(
                splats, K, np.eye(4), size, size, background=tuple(background), device="cpu"
            )
            milliseconds = (time.perf_counter() - began) * 1000
            error = max(
                np.abs(picture.rgb - expected)[certain].max(),
                np.abs(picture.alpha - alpha)[certain].max(),
            )
            results[isa] = {"error": float(error), "milliseconds": round(milliseconds, 3)}
    finally:
        native_library.set_isa(before)
    return results


def _graphics_rows(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """A row for each device and for each reason why one is missing."""
    rows = [("graphics", problem) for problem in facts["device_problems"]]
    for device in facts["devices"]:
        memory = size_text(device["memory_bytes"])
        if device["memory_free_bytes"] is not None:
            memory += f", {size_text(device['memory_free_bytes'])} free"
        state = device["reason"] or ("passed its self-test" if device["verdict"] else NOT_TESTED)
        what = f"{device['name']}, {device['kind']}, {memory}, {device['driver']}"
        rows.append((f"device {device['number']}", f"{what}: {state}"))
    return rows


def _text(facts: dict[str, Any]) -> str:
    native = facts["native"]
    memory = size_text(facts["memory_bytes"])
    if facts["memory_available_bytes"] is not None:
        memory += f", {size_text(facts['memory_available_bytes'])} free"
    if facts["memory_is_short"]:
        memory += "; low: train with `--resolution 2` and fewer `--max-splats`"
    rows = [
        ("gscore", facts["gscore"]),
        ("Python", f"{facts['python']} ({facts['executable']})"),
        ("platform", facts["platform"]),
        ("processor", f"{facts['cpu']} ({facts['arch']}), {count_text(facts['cores'], 'core')}"),
        ("memory", memory),
        ("library", native["library"]),
    ]
    if "isa" in native:
        others = ", ".join(i for i in native["isas"] if i != native["isa"])
        also = f" (available: {others})" if others else ""
        rows.append(("uses", f"{native['isa']}{also}, {count_text(native['threads'], 'thread')}"))
    for isa, found in native.get("self_test", {}).items():
        verdict = "ok" if found["error"] <= _TOLERANCE else "WRONG"
        rows.append(("self-test", f"{isa}: {verdict}, error {found['error']:.1e}"))
    if native["problem"]:
        rows.append(("problem", native["problem"]))
    rows += _graphics_rows(facts)
    optionals = {part.distribution for part in _PARTS if not part.offered}
    for name, part in facts["packages"].items():
        optional = ", optional" if name in optionals and part["problem"] == _ABSENT else ""
        state = f"{part['version'] or ''} {part['problem']}{optional}".strip()
        rows.append((name, f"{state}  ({part['use']})"))
    lines = [f"{label:12} {value}" for label, value in rows]
    if facts["install"]:
        lines.append(f"To install missing packages: {facts['install']}")
    if "gpu_report" in facts:
        lines.append(f"Report on the graphics cards: {facts['gpu_report']}")
    if facts["can_train"]:
        lines.append("This machine can train.")
    else:
        lines.append(
            f"This machine cannot train without: {', '.join(facts['missing'])}. See above."
        )
    return "\n".join(lines)

"""Oracle: the layers of docs/architecture.md, read off the syntax trees; and fresh interpreters."""

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import gscore
from gscore import frontend
from tests.for_each import for_each

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "gscore"

BOTTOM = {
    "errors",
    "_version",
    "splats",
    "camera_neighbours",
    "scene",
    "sequence_options",
    "quoting",
    "smallest_three",
    "json_text",
    "option_marks",
    "options",
    "photo_exposure",
    "presets",
    "robust",
    "sampling",
    "choices",
    "config",
    "config_command",
    "config_file",
    "control",
    "ending_signals",
    "events",
    "extras",
    "glsl",
    "shared_constants",
    "hold_out",
    "importance",
    "live_options",
    "warning_log",
    "morton",
    "sh",
    "transforms",
    "upright",
    "text_format",
}
ALLOWED = {
    **dict.fromkeys(BOTTOM, BOTTOM),
    "io": BOTTOM | {"io"},
    "formats": BOTTOM | {"io", "formats"},
    "datasets": BOTTOM | {"io", "datasets"},
    "video": BOTTOM | {"io", "video"},
    "sfm": BOTTOM | {"io", "datasets", "video", "raster", "sfm"},
    "depth": BOTTOM | {"io", "datasets", "depth"},
    "inspection": BOTTOM | {"io", "datasets", "video", "sfm", "depth", "inspection"},
    "raster": BOTTOM | {"io", "formats", "raster"},
    "engine": BOTTOM | {"raster", "engine"},
    "edit": BOTTOM | {"io", "formats", "raster", "edit"},
    "lod": BOTTOM | {"io", "formats", "raster", "edit", "lod"},
    "blocks": BOTTOM | {"io", "formats", "datasets", "edit", "blocks"},
    "stereo": BOTTOM | {"io", "datasets", "depth", "raster", "stereo"},
    "metrics": BOTTOM | {"io", "datasets", "depth", "raster", "metrics"},
    "report": BOTTOM | {"io", "metrics", "report"},
    "page": BOTTOM | {"io", "page"},
    "viewers": BOTTOM | {"raster", "metrics", "viewers"},
    "mesh": BOTTOM | {"io", "formats", "raster", "mesh"},
    "live": BOTTOM | {"live"},
    "trainer": BOTTOM
    | {"io", "formats", "datasets", "depth", "raster", "engine", "stereo", "metrics", "report"}
    | {"live", "trainer"},
    "stress": BOTTOM
    | {"io", "datasets", "depth", "raster", "engine", "stereo", "metrics", "live", "trainer"}
    | {"stress"},
    "bench": BOTTOM
    | {"io", "datasets", "depth", "raster", "stereo", "metrics", "live", "trainer", "bench"},
}
TOP = {"__init__", "__main__", "frontend", "commands"}
"""May import any layer."""
OUTSIDE = {
    "torch": {"raster", "engine", "metrics", "viewers", "trainer", "stress", "bench", "commands"},
    "bpy": set(),
    "addon": set(),
}
"""Layers that may import a package at all."""

TRAINER = {
    "host": set(),
    "schedule": set(),
    "model": {"schedule"},
    "estimate": {"model", "schedule"},
    "photos": {"host", "model", "schedule"},
    "distributed": {"model"},
    "depth": {"host", "photos", "model", "schedule"},
    "region": {"photos", "model"},
    "guide": {"depth", "photos", "model"},
    "strategy": {"host", "photos", "model", "schedule"},
    "views": {"photos", "region", "model"},
    "step": {"depth", "guide", "host", "photos", "distributed", "model", "schedule", "strategy"}
    | {"analysis", "region", "views"},
    "analysis": {"depth", "estimate", "guide", "model", "photos", "region", "schedule", "views"},
    "trainer": {"depth", "guide", "host", "photos", "distributed", "region", "model", "schedule"}
    | {"analysis", "estimate", "step", "strategy", "views"},
    "distributed_trainer": {"analysis", "distributed", "model", "schedule", "step", "trainer"},
    "evaluation": {"photos", "trainer"},
    "preflight": {"trainer"},
    "stopping": {"estimate", "evaluation", "model", "schedule", "trainer"},
    "files": {
        "depth",
        "evaluation",
        "stopping",
        "photos",
        "distributed",
        "model",
        "trainer",
        "views",
    },
    "prepare": {
        "analysis",
        "depth",
        "guide",
        "photos",
        "distributed",
        "region",
        "model",
        "schedule",
        "distributed_trainer",
        "trainer",
        "views",
    },
    "session": {
        "depth",
        "estimate",
        "evaluation",
        "files",
        "stopping",
        "distributed",
        "model",
        "step",
        "prepare",
    },
    "run_start": {"files", "photos", "model", "prepare", "session", "trainer"},
    "worker_rank": {"host", "prepare", "distributed", "trainer"},
    "run": {
        "estimate",
        "run_start",
        "files",
        "host",
        "preflight",
        "prepare",
        "distributed",
        "session",
    },
    "frames": {"files"},
    "sequence": {"files", "frames", "distributed", "run"},
}
"""What each hall of the trainer, or file beside them, may import of the trainer besides itself."""
MOST_OUTSIDE_HALLS = 11
MOST_PUBLIC = 40
IMPORTED = {"gscore", "gscore._version"}
"""What `import gscore` loads of gscore."""
NOT_IMPORTED = {
    *("torch", "numpy", "bpy", "scipy", "PIL"),
    *("argparse", "asyncio", "ctypes", "dataclasses", "inspect", "json", "logging"),
    *("pathlib", "signal", "subprocess", "tempfile", "threading"),
}
"""What `import gscore` leaves to those who need it: each takes a millisecond or more."""
DOORS = {"gscore", "gscore.frontend"}
"""What the add-on may see of gscore."""

ADDON = ROOT / "addon"
IN_BLENDER = {"blf", "bmesh", "bpy", "bpy_extras", "gpu", "gpu_extras", "mathutils", "numpy"}
"""What the add-on may import besides the standard library and itself."""
_FLOOR = {"attributes", "compat", "core", "equality", "registration", "srgb"}
_FILES = _FLOOR | {"capture", "paths", "stored_paths", "run_links"}
_SHARED = _FILES | {"interface", "preferences", "process"}
_OBJECTS = _SHARED | {"cameras", "nodes", "splats", "triangles"}
ROOMS = {
    "core": set(),
    "compat": set(),
    "registration": set(),
    "triangles": set(),
    "srgb": set(),
    "equality": set(),
    "attributes": {"core"},
    "capture": {"core"},
    "process": set(),
    "interface": {"core", "process"},
    "paths": {"capture", "core"},
    "stored_paths": {"paths"},
    "run_links": {"capture", "compat", "core", "paths"},
    "preferences": {"core", "interface", "paths"},
    "trainer_python": _SHARED,
    "nodes": _FLOOR,
    "cameras": _SHARED | {"nodes"},
    "splats": _SHARED | {"cameras", "nodes", "trainer_python", "triangles"},
    "training": _OBJECTS | {"trainer_python"},
    "sfm": _OBJECTS | {"trainer_python", "training"},
    "depth": _OBJECTS | {"trainer_python", "training"},
    "region_training": _OBJECTS | {"training", "render"},
    "error_maps": _OBJECTS | {"training"},
    "surface": _OBJECTS | {"training", "render"},
    "viewers": _OBJECTS | {"training", "render"},
    "timeline": _OBJECTS | {"training"},
    "sequence": _OBJECTS | {"training", "timeline"},
    "render": _OBJECTS | {"timeline"},
    "live": _OBJECTS | {"render"},
    "paint": _OBJECTS | {"timeline", "render"},
    "histograms": _OBJECTS,
    "panels": _OBJECTS
    | {
        "histograms",
        "trainer_python",
        "training",
        "sfm",
        "depth",
        "region_training",
        "error_maps",
        "surface",
        "viewers",
        "timeline",
        "sequence",
        "render",
        "live",
        "paint",
    },
}
"""What each room of the add-on, or file beside them, may import besides itself."""
WITHOUT_BPY = (
    "attributes",
    "cameras.alignment",
    "cameras.camera_math",
    "cameras.undistort_queue",
    "capture.depth_maps",
    "capture.folders",
    "capture.inspection",
    "histograms.boxes",
    "histograms.counting",
    "histograms.limits",
    "interface.lookup",
    "training.lookups",
    "training.options",
    "training.run_state",
    "training.verb_job",
    "live.atlas",
    "live.level",
    "live.order",
    "paint.brush",
    "process.background_task",
    "process.incremental_tasks",
    "process.child_program",
    "trainer_python.environment",
    "trainer_python.installer",
    "splats.point_attributes",
    "splats.filters",
    "splats.live_display",
    "srgb",
    "equality",
    "timeline.frames",
    "timeline.library",
)
"""Modules of the add-on that serve scripts outside Blender."""


def _files() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def _layer(path: Path) -> str:
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def _imports(path: Path) -> list[tuple[str, bool]]:
    """Dotted names of what a file imports, and whether they lie inside gscore."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [(alias.name, alias.name.split(".")[0] == "gscore") for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.append((node.module or "", (node.module or "").split(".")[0] == "gscore"))
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1]
            stem = [*base, *(node.module.split(".") if node.module else [])]
            found += [(".".join([*stem, alias.name]), True) for alias in node.names]
    return found


@for_each(_files())
def test_imports_point_down(path: Path) -> None:
    """Oracle: ALLOWED."""
    layer = _layer(path)
    if layer in TOP:
        return
    for name, inside in _imports(path):
        if inside:
            target = name.split(".")[1]
            assert target in ALLOWED[layer], f"{path.name} ({layer}) imports {name}"
            if "_native" in name.split("."):
                assert layer in {"raster", "bench", "stress"}, (
                    f"{path.name}: only raster sees the library"
                )
        else:
            package = name.split(".")[0]
            assert layer in OUTSIDE.get(package, {layer}), f"{path.name} ({layer}) imports {name}"


def test_every_layer_is_covered() -> None:
    """Oracle: the folder listing; a new package must be given its place."""
    layers = {_layer(path) for path in _files()} - TOP
    assert layers == set(ALLOWED)


@for_each(sorted((PACKAGE / "trainer").rglob("*.py")))
def test_halls_of_the_trainer_import_down(path: Path) -> None:
    """Oracle: TRAINER, for imports at the top of a file and inside of functions."""
    own = path.relative_to(PACKAGE / "trainer").with_suffix("").parts[0]
    for name, inside in _imports(path):
        parts = name.split(".")
        if inside and parts[1] == "trainer":
            assert parts[2] in TRAINER[own] | {own}, f"{own} imports {name}"


def test_arguments_stay_on_the_command_line() -> None:
    """Oracle: imports of argparse; a namespace has no types, and anybody may write into it. The
    training, its blocks, frames and ranks receive a request."""
    users = {path.relative_to(PACKAGE) for path in _files() if "argparse" in dict(_imports(path))}
    assert {path.parts[0] for path in users} <= {"commands"}
    typed = ("block_runs", "torchrun", "find_cameras", "args/unused_options")
    assert not users & {Path(f"commands/{name}.py") for name in typed}


def test_every_hall_of_the_trainer_has_its_place() -> None:
    """Oracle: the folder listing; an order in which each imports only earlier ones; few files lie
    beside the halls."""
    folder = PACKAGE / "trainer"
    there = {path.relative_to(folder).with_suffix("").parts[0] for path in folder.rglob("*.py")}
    assert there - {"__init__"} == set(TRAINER)
    assert len(list(folder.glob("*.py"))) <= MOST_OUTSIDE_HALLS
    TopologicalSorter(TRAINER).prepare()  # raises where there is a circle


def test_an_estimate_needs_no_torch() -> None:
    """Oracle: a fresh interpreter in which torch cannot be imported."""
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "import gscore\n"
        "from gscore import frontend\n"
        "found = frontend.estimate(gscore.TrainConfig(), [(320, 240)] * 8, points=100, pace=1.0)\n"
        "print(found.seconds > 0)"
    )
    assert _fresh(code) == "True"


def _fresh(code: str, *options: str) -> str:
    done = subprocess.run(
        [sys.executable, *options, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True
    )
    return done.stdout.strip()


def test_import_is_light() -> None:
    """Oracle: the modules of a fresh interpreter without site-packages: gscore's own are IMPORTED,
    and none of NOT_IMPORTED is there."""
    code = "import sys, gscore; print(*sys.modules)"
    found = set(_fresh(code, "-S").split())
    assert {name for name in found if name.startswith("gscore")} == IMPORTED
    assert not found & NOT_IMPORTED


def test_rendering_needs_no_torch() -> None:
    """Oracle: the modules of a fresh interpreter in which torch cannot be imported."""
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "import numpy as np, gscore\n"
        "f = lambda *s: np.zeros(s, np.float32)\n"
        "m = f(1, 3); m[0, 2] = 2; q = f(1, 4); q[0, 0] = 1; s = f(1, 3) - 2; o = f(1) + 3\n"
        "h, r = f(1, 1, 3), f(1, 0, 3)\n"
        "p = gscore.Splats(means=m, quats=q, scales=s, opacities=o, sh0=h, shN=r)\n"
        "K = np.array([[50, 0, 16.5], [0, 50, 16.5], [0, 0, 1.0]])\n"
        "v = gscore.render(p, K, np.eye(4), 33, 33)\n"
        "print(round(float(v.alpha[16, 16]), 5), round(float(v.depth[16, 16]), 5))"
    )
    assert _fresh(code) == "0.95257 2.0"


@for_each(sorted(DOORS))
def test_public_names_exist(door: str) -> None:
    """Oracle: `__all__`."""
    code = f"import {door} as d; print(all(getattr(d, n) is not None for n in d.__all__))"
    assert _fresh(code) == "True"


def test_each_name_has_one_door() -> None:
    """Oracle: the lists of both; what scripts use stays few enough to be read in one go."""
    assert not set(gscore.__all__) & set(frontend.__all__)
    assert len(gscore.__all__) <= MOST_PUBLIC


@for_each(sorted(ADDON.rglob("*.py")))
def test_the_addon_sees_only_what_is_public(path: Path) -> None:
    """Oracle: DOORS, IN_BLENDER, and the add-on's own folder for relative imports."""
    depth = len(path.relative_to(ADDON).parts)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            assert node.level <= depth, f"line {node.lineno}: leaves the add-on"
            continue
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            modules = [node.module or ""]
        else:
            continue
        for module in modules:
            package = module.split(".")[0]
            if package != "gscore":
                known = package in IN_BLENDER or package in sys.stdlib_module_names
                assert known, f"line {node.lineno}: imports {module}"
                continue
            assert path == ADDON / "core.py", f"line {node.lineno}: only core.py sees gscore"
            assert module in DOORS


@for_each(sorted(ADDON.rglob("*.py")))
def test_rooms_of_the_addon_import_down(path: Path) -> None:
    """Oracle: ROOMS, for imports at the top of a file and inside of functions."""
    own = _room(path)
    if own == "__init__":
        return
    package = path.relative_to(ADDON).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not (isinstance(node, ast.ImportFrom) and node.level):
            continue
        stem = [*package[: len(package) + 1 - node.level], *(node.module or "").split(".")]
        for alias in node.names:
            room = next(part for part in (*stem, alias.name) if part)
            assert room in ROOMS[own] | {own}, f"line {node.lineno}: {own} imports {room}"


def test_every_room_has_its_place() -> None:
    """Oracle: the folder listing; and an order in which each imports only earlier ones."""
    assert {_room(path) for path in ADDON.rglob("*.py")} - {"__init__"} == set(ROOMS)
    TopologicalSorter(ROOMS).prepare()  # raises where there is a circle


def test_no_function_of_the_addon_rebinds_a_module() -> None:
    """Oracle: the syntax trees; what lives as long as Blender is an object with methods."""
    for path in ADDON.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        lines = [node.lineno for node in ast.walk(tree) if isinstance(node, ast.Global)]
        assert not lines, f"{path.relative_to(ADDON)}: line {lines[0]}"


def _room(path: Path) -> str:
    return path.relative_to(ADDON).with_suffix("").parts[0]


def test_plain_modules_need_no_bpy() -> None:
    """Oracle: a fresh interpreter in which neither bpy nor torch can be imported."""
    code = (
        "import importlib, sys; sys.modules.update(bpy=None, mathutils=None, torch=None)\n"
        "for name in sys.argv[1:]:\n"
        "    try:\n"
        "        importlib.import_module('addon.' + name)\n"
        "    except ImportError as error:\n"
        "        print(name, error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *WITHOUT_BPY], capture_output=True, text=True, cwd=ROOT
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")

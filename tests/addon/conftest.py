"""Fixtures of the add-on's tests: a real Blender with a separate profile, and empty scenes.

The folder is skipped where Python has no bpy. Blender enables the add-on once per session, as a
user would, and disables it at the end: a class that is still registered when the interpreter exits
hangs bpy 4.5.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

ROOT = Path(__file__).parent.parent.parent

_STATUS = pytest.StashKey[int]()

collect_ignore_glob = [] if find_spec("bpy") else ["*"]

if TYPE_CHECKING:
    from addon.core import Splats
    from tests.addon.writes import Writes

if find_spec("bpy"):
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))
    if "bpy" not in sys.modules:  # a Blender program has read its profile before this file
        os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp(prefix="blender-profile-")
    import bpy


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Keep the exit status for the end."""
    session.config.stash[_STATUS] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """End the process here where Blender would crash after the last test.

    bpy 4.2 keeps the update functions of properties forever, and with them itself; then it frees
    its panels when there is no Python any more.
    """
    if "bpy" in sys.modules and bpy.app.version < (4, 5) and not bpy.app.binary_path:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(config.stash.get(_STATUS, 1))


def _raise(error: Exception) -> None:
    raise error


def _switch(on: bool) -> None:
    """Enable or disable the checkout's add-on through Blender, as the preferences do."""
    import addon_utils  # only there once bpy is

    if on:
        addon_utils.enable("addon", default_set=True, persistent=True, handle_error=_raise)
    else:
        addon_utils.disable("addon", default_set=True, handle_error=_raise)


@pytest.fixture(scope="session", autouse=True)
def enabled() -> Iterator[None]:
    """The add-on is registered while tests run."""
    _switch(True)
    yield
    _switch(False)
    profile = Path(os.environ.get("BLENDER_USER_RESOURCES", ""))
    if profile.name.startswith("blender-profile-"):
        shutil.rmtree(profile, ignore_errors=True)


@pytest.fixture(scope="session", autouse=True)
def display_built_once(
    enabled: None, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, Callable]]:
    """The display of splats is built by the first test that needs it; other scenes read it from a
    file, which takes a tenth of the time. Returns the functions that build it."""
    from addon.nodes import display

    path = tmp_path_factory.mktemp("nodes") / "nodes.blend"
    building: dict[str, Callable] = {"group": display.group, "builders": display.builders}

    def group() -> "bpy.types.NodeTree":
        own = (tree.name for tree in bpy.data.node_groups if tree.library is None)
        if any(name.startswith("Splat ") for name in own):
            return building["group"]()
        if not path.is_file():
            made = building["group"]()
            bpy.data.libraries.write(str(path), {made})
            return made
        with bpy.data.libraries.load(str(path)) as (_, wanted):
            wanted.node_groups = [display.NAME]
        bpy.data.libraries.remove(bpy.data.libraries[path.name])
        return wanted.node_groups[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(display, "group", group)
        patch.setattr(display, "builders", lambda: [display.group])
        yield building


@pytest.fixture
def built_anew(display_built_once: dict[str, Callable], monkeypatch: pytest.MonkeyPatch) -> None:
    """The display of splats is built in each scene of the test."""
    from addon.nodes import display

    for name, build in display_built_once.items():
        monkeypatch.setattr(display, name, build)


@pytest.fixture(scope="session")
def writes() -> "Writes":
    """Files that the add-on has written since the test began; the audit hook cannot be removed."""
    from tests.addon.writes import Writes

    return Writes()


@pytest.fixture(autouse=True)
def writes_where_it_may(
    writes: "Writes", tmp_path_factory: pytest.TempPathFactory
) -> Iterator[None]:
    """The add-on writes only to folders chosen by a test, as by a user, and to Blender's own."""
    yield
    own = Path(bpy.utils.resource_path("USER")), Path(bpy.app.tempdir)
    outside = writes.outside(tmp_path_factory.getbasetemp(), *own)
    writes.paths.clear()
    assert not outside, f"the add-on wrote to {outside}"


@pytest.fixture
def switch() -> Callable[[bool], None]:
    """Enables (True) or disables (False) the add-on."""
    return _switch


@pytest.fixture
def scene() -> "bpy.types.Scene":
    """The scene of a new, empty file."""
    bpy.ops.wm.read_homefile(use_empty=True)
    return bpy.context.scene


@pytest.fixture
def no_work() -> Iterator[None]:
    """No job is left when the test ends, and the preferences are those of before."""
    from addon import preferences
    from addon.training import registry
    from addon.training.verb_jobs import JOBS

    prefs = preferences.get()
    names = ("python_path", "depth_model", "depth_network")
    names += ("live_seconds", "live_most", "preview_seconds")
    before = {name: getattr(prefs, name) for name in names}
    yield
    JOBS.kill_all()
    for job in registry.jobs():
        job.kill()
        job.wait(60)
        registry.remove(job)
    for name, value in before.items():
        setattr(prefs, name, value)


@pytest.fixture
def play(tmp_path: Path, no_work: None) -> Callable[..., Path]:
    """Replaces the preferences' Python by a fake that plays a script (`fake_trainer`); returns the
    file of its arguments."""
    from addon import preferences
    from tests.addon.fake_trainer import fake_python

    def choose(*script: dict, name: str = "python") -> Path:
        python = fake_python(tmp_path / name, list(script))
        preferences.get().python_path = str(python)
        return python.with_name("script.args")

    return choose


@pytest.fixture
def studio(scene: "bpy.types.Scene", tmp_path: Path, no_work: None) -> "bpy.types.Scene":
    """A scene with the inspected studio as capture, and an output folder."""
    from addon.training import facts
    from tests.addon.captures import STUDIO

    scene.gscore.capture_path = str(STUDIO)
    scene.gscore.output_path = str(tmp_path / "out")
    scene.gscore.preset = "preview"
    facts.refresh(scene)
    return scene


@pytest.fixture
def run_blender(tmp_path: Path) -> Callable[..., str]:
    """Run a Python script, its text or its path, in a fresh Blender with an empty profile.

    Returns the output, or fails. In the bpy module the fresh Blender is a fresh Python, else it is
    the program that runs.
    """

    def run(
        script: str | Path, *args: str | Path, cwd: Path = tmp_path, timeout: float = 240
    ) -> str:
        path, profile = tmp_path / "script.py", tmp_path / "profile"
        if isinstance(script, Path):
            path = script
        else:
            path.write_text(script, encoding="utf-8")
        profile.mkdir(exist_ok=True)
        program = bpy.app.binary_path
        environment = {**os.environ, "BLENDER_USER_RESOURCES": str(profile)}
        packages = environment.pop("PYTHONPATH", "")
        command = [sys.executable, str(path)]
        if program:
            command = [program, "-b", "--factory-startup", "--python-exit-code", "1"]
            command += ["--python-expr", f"import sys; sys.path.append({packages!r})"]
            command += ["-P", str(path), "--"]
        done = subprocess.run(
            [*command, *map(str, args)],
            cwd=cwd,
            env=environment,
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )
        assert done.returncode == 0, f"rc {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    return run


@pytest.fixture
def make_splats() -> "Callable[..., Splats]":
    """Deterministic random splats with unit quaternions and the spread of trained ones."""
    import numpy as np

    from addon.core import Splats

    def make(count: int = 500, rest: int = 15, seed: int = 0) -> Splats:
        rng = np.random.default_rng(seed)
        quats = rng.normal(size=(count, 4))
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        return Splats(
            means=rng.normal(size=(count, 3)).astype(np.float32),
            quats=quats.astype(np.float32),
            scales=rng.uniform(-9, -1.1, (count, 3)).astype(np.float32),
            opacities=rng.uniform(-8, 5, count).astype(np.float32),
            sh0=rng.normal(size=(count, 1, 3)).astype(np.float32),
            shN=rng.normal(size=(count, rest, 3)).astype(np.float32) * np.float32(0.2),
        )

    return make

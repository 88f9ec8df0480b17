"""Oracle: Blender's own lists of classes, properties and handlers, before and after."""

import ast
import importlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import pytest
from bl_ui.space_toolsystem_common import ToolSelectPanelHelper

import addon
from addon.registration import classes_of

ROOT = Path(__file__).parent.parent.parent
ENABLED_AND_DISABLED = """
import sys
import bpy
import addon_utils
sys.path.insert(0, {root!r})
assert addon_utils.enable("addon", default_set=True) is not None
addon_utils.disable("addon")
"""
OWNERS = (bpy.types.Scene, bpy.types.Object, bpy.types.WindowManager, bpy.types.Camera)


def _subclasses(cls: type) -> Iterator[type]:
    for sub in cls.__subclasses__():
        yield sub
        yield from _subclasses(sub)


def _ours() -> set[str]:
    """All registrations of the add-on in Blender."""
    found = {
        f"class {cls.__name__}"
        for cls in _subclasses(bpy.types.bpy_struct)
        if cls.__module__.split(".")[0] == "addon" and getattr(cls, "is_registered", False)
    }
    tools = ToolSelectPanelHelper._tool_class_from_space_type("VIEW_3D")._tools["OBJECT"]
    names = [tool.idname for tool in ToolSelectPanelHelper._tools_flatten(tools) if tool]
    found |= {f"tool {name}" for name in names if name.startswith("gscore")}
    found |= {f"operator {name}" for name in dir(bpy.ops.gscore)}
    for owner in OWNERS:
        names = owner.bl_rna.properties.keys()
        found |= {f"property {owner.__name__}.{name}" for name in names if name.startswith("gs")}
    for name in dir(bpy.app.handlers):
        handlers = getattr(bpy.app.handlers, name)
        if isinstance(handlers, list):
            theirs = [h for h in handlers if h.__module__.split(".")[0] == "addon"]
            found |= {f"handler {name} {handler.__name__}" for handler in theirs}
    return found


@pytest.fixture
def disabled(switch: Callable[[bool], None]) -> Iterator[Callable[[bool], None]]:
    """The add-on is disabled; enabled again after the test."""
    switch(False)
    yield switch
    switch(True)


def test_every_module_registers() -> None:
    """Oracle: MODULES, each with what `registration` reads; it includes every module that has
    any."""
    lists = ("PROPERTIES", "HANDLERS", "APPENDED", "DRAWING")
    marks = {*lists, "on_register", "on_unregister"}
    for name in addon.MODULES:
        module = importlib.import_module(f"addon.{name}")
        assert classes_of(module) or any(hasattr(module, mark) for mark in marks), name
    for path in (ROOT / "addon").rglob("*.py"):
        name = ".".join(path.relative_to(ROOT / "addon").with_suffix("").parts)
        name = name.removesuffix(".__init__")
        tree = ast.parse(path.read_text(encoding="utf-8"))
        defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        assigned = (node.targets for node in tree.body if isinstance(node, ast.Assign))
        named = {one.id for names in assigned for one in names if isinstance(one, ast.Name)}
        blender = ("bpy.types.Operator", "bpy.types.Panel", "bpy.types.PropertyGroup")
        classes = (node.bases for node in tree.body if isinstance(node, ast.ClassDef))
        derived = any(ast.unparse(base) in blender for bases in classes for base in bases)
        if derived or (defined | named) & marks:
            assert name in addon.MODULES, name


def test_disabling_leaves_nothing(disabled: Callable[[bool], None]) -> None:
    """Oracle: Blender's lists have nothing of the add-on."""
    assert _ours() == set()


def test_enabling_again_brings_the_same(switch: Callable[[bool], None]) -> None:
    """Oracle: Blender's lists after the first time, three times over."""
    before = _ours()
    assert before
    for _ in range(3):
        switch(False)
        switch(True)
        assert _ours() == before


def test_a_failure_leaves_nothing(
    disabled: Callable[[bool], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: Blender's lists are empty after the last module failed to register."""
    last = importlib.import_module(f"addon.{addon.MODULES[-1]}")

    def refuse() -> None:
        raise RuntimeError("refused")

    with monkeypatch.context() as patch:
        patch.setattr(last, "on_register", refuse, raising=False)
        with pytest.raises(RuntimeError, match="refused"):
            addon.register()
    assert _ours() == set()


def test_a_new_file_keeps_the_add_on(scene: bpy.types.Scene) -> None:
    """Oracle: the operators exist in the empty file."""
    assert scene.objects.keys() == []
    assert [name for name in _ours() if name.startswith("operator")]


def test_every_operator_and_property_explains_itself() -> None:
    """Oracle: Blender's RNA, the source of tooltips."""
    types = {f"gscore.{n}": getattr(bpy.ops.gscore, n).get_rna_type() for n in dir(bpy.ops.gscore)}
    silent = [name for name, rna in types.items() if not (rna.name and rna.description)]
    groups = (bpy.types.PropertyGroup, bpy.types.AddonPreferences)
    for cls in _subclasses(bpy.types.bpy_struct):
        if cls.__module__.split(".")[0] == "addon" and issubclass(cls, groups):
            types[cls.__name__] = cls.bl_rna
    for name, rna in types.items():
        inherited = {p.identifier for p in rna.base.properties} if rna.base else set()
        for prop in rna.properties:
            if prop.identifier in inherited | {"rna_type", "name"} or prop.is_hidden:
                continue
            if not prop.description and prop.type not in {"POINTER", "COLLECTION"}:
                silent.append(f"{name}.{prop.identifier}")
    assert len(types) > 10
    assert silent == []


def test_the_root_is_empty_outside_blender() -> None:
    """Oracle: a fresh interpreter in which bpy cannot be imported."""
    code = (
        "import sys, importlib.util as u; sys.modules['bpy'] = None\n"
        f"spec = u.spec_from_file_location('root', r'{ROOT / '__init__.py'}')\n"
        "module = u.module_from_spec(spec); spec.loader.exec_module(module)\n"
        "print(hasattr(module, 'register'))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.skipif(bpy.app.version < (4, 5), reason="bpy 4.2 crashes with any add-on at its end")
def test_python_ends_after_the_add_on_was_used(run_blender: Callable[..., str]) -> None:
    """Nothing keeps bpy alive when Python ends; otherwise bpy 4.5 hangs forever."""
    run_blender(ENABLED_AND_DISABLED.format(root=str(ROOT)), timeout=60)

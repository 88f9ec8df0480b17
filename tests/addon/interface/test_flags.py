"""Messages of the trainer in a panel: no flag of the command line is left."""

import ast
from pathlib import Path

import bpy
import pytest

import addon
from addon.core import GsError
from addon.interface.base_operator import BaseOperator, ConfirmMixin
from addon.interface.option_labels import panel_text
from addon.training.run_state import read_event
from gscore.events import Failed, Warn, to_line

ADDON = Path(addon.__file__).parent


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("Not used; `--depth-mode on` uses it.", 'Not used; "Use Depth: Always" uses it.'),
        ("Give fewer `--max-splats`.", 'Give fewer "Max Splats".'),
        ("Use smaller photos (`--resolution 2`).", 'Use smaller photos ("Photo Size: 2").'),
        ("Give it with `--images My_Photos`.", 'Give it with "Photo Folder: My_Photos".'),
        ("`--exposure off` takes colours as they are.", "the option exposure (off) takes"),
        ("Give `--mask-mode ignore`: then", 'Give "Mask Mode: Ignore Masked": then'),
        (
            'pip install "gscore[train]" --extra-index-url https://a.b. Fewer `--max-splats`.',
            'pip install "gscore[train]" --extra-index-url https://a.b. Fewer "Max Splats".',
        ),
        ("An old run: --depth-mode on uses it.", "An old run: --depth-mode on uses it."),
        ("/tmp/a`b and `--x stay", "/tmp/a`b and `--x stay"),
    ],
)
def test_names_of_panels(scene: bpy.types.Scene, said: str, shown: str) -> None:
    """Oracle: the names of the panel's own properties."""
    assert scene.gscore.bl_rna.properties["depth_mode"].name == "Use Depth"
    assert scene.gscore.bl_rna.properties["max_splats"].name == "Max Splats"
    assert scene.gscore.bl_rna.properties["resolution"].name == "Photo Size"
    assert panel_text(said).startswith(shown)


def test_warnings_and_failures_of_a_process(scene: bpy.types.Scene) -> None:
    """Oracle: lines of the trainer."""
    warned = read_event(to_line(Warn(message="Try `--depth-mode off`.", code="depth")))
    assert isinstance(warned, Warn) and warned.message == 'Try "Use Depth: Never".'
    failed = read_event(to_line(Failed(message="Needs `--max-splats`.")))
    assert isinstance(failed, Failed) and failed.message == 'Needs "Max Splats".'


@pytest.mark.parametrize(
    ("error", "shown"),
    [
        (GsError("Give its name with `--images`."), 'Give its name with "Photo Folder".'),
        (ValueError("There is no folder /a b/ --images."), "There is no folder /a b/ --images."),
    ],
)
def test_errors_of_operators(scene: bpy.types.Scene, error: Exception, shown: str) -> None:
    """Oracle: the field's name in errors of gscore; the add-on's own messages stay."""

    class Refusing(ConfirmMixin, BaseOperator):
        def run(self, context: bpy.types.Context) -> str:
            raise error

        confirm_lines = run

        def report(self, kinds: set[str], text: str) -> None:
            said.append((kinds, text))

    assert scene.gscore.bl_rna.properties["images"].name == "Photo Folder"
    said: list[tuple[set[str], str]] = []
    assert Refusing().execute(bpy.context) == {"CANCELLED"}
    assert Refusing().invoke(bpy.context, None) == {"CANCELLED"}
    assert said == [({"ERROR"}, shown)] * 2


def test_no_error_of_gscore_is_shown_as_it_is() -> None:
    """Oracle: the syntax trees of all files. Handlers of GsError, or of all exceptions, convert it
    to text by `error_text` only; only code without panels uses the error's own text."""
    found = {
        path.relative_to(ADDON).as_posix()
        for path in sorted(ADDON.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ExceptHandler) and _takes_all(node) and _as_text(node)
    }
    assert found == {"process/background_task.py", "trainer_python/installer.py"}


def _takes_all(handler: ast.ExceptHandler) -> bool:
    """Whether a handler catches errors of gscore too."""
    taken = {node.id for node in ast.walk(handler.type) if isinstance(node, ast.Name)}
    return bool(taken & {"GsError", "DatasetError", "Exception"})


def _as_text(handler: ast.ExceptHandler) -> bool:
    """Whether the error itself is made a text: by str(error), format(error), or in an f-string."""
    for node in ast.walk(handler):
        parts = (
            [node.value] if isinstance(node, ast.FormattedValue) and node.conversion != 114 else []
        )
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("str", "format"):
            parts = node.args
        if any(isinstance(part, ast.Name) and part.id == handler.name for part in parts):
            return True
    return False

"""Oracle: Blender's own list of its dialog's parameters, and the recorded dialog."""

from types import SimpleNamespace

import bpy
import pytest

from addon.depth.predict_depth import PredictDepth
from addon.interface.base_operator import BaseOperator, ConfirmMixin
from addon.trainer_python.operators import MakeEnvironment
from addon.training.operators import DiscardTraining, Train


class Danger(ConfirmMixin, BaseOperator):
    """An operator without Blender."""

    bl_label, confirm = "Danger", "Do It"

    def __init__(self, *lines: str, problem: str = "") -> None:
        self.asked, self.problem, self.done = list(lines), problem, 0
        self.reports: list[tuple[set[str], str]] = []

    def confirm_lines(self, context: object) -> list[str]:
        """The given text."""
        if self.problem:
            raise ValueError(self.problem)
        return self.asked

    def run(self, context: object) -> str:
        """Count."""
        self.done += 1
        return "done"

    def report(self, kind: set[str], text: str) -> None:
        """Keep it."""
        self.reports.append((kind, text))


def invoked(operator: Danger) -> tuple[set[str], list[dict]]:
    """Result of `invoke`, and the opened dialogs."""
    dialogs: list[dict] = []

    def dialog(operator: Danger, **options: object) -> set[str]:
        dialogs.append(options)
        return {"RUNNING_MODAL"}

    manager = SimpleNamespace(invoke_props_dialog=dialog)
    return operator.invoke(SimpleNamespace(window_manager=manager), None), dialogs


def test_dialog_shows_all_sentences() -> None:
    """The dialog is Blender's, its default is Cancel, and it shows every sentence completely."""
    text = "The run in /somewhere/that/is/rather/long is replaced for good. " * 3
    operator = Danger(text, "And the object.")
    result, (options,) = invoked(operator)
    known = bpy.types.WindowManager.bl_rna.functions["invoke_props_dialog"].parameters
    assert set(options) <= set(known.keys())
    assert (options["title"], options["confirm_text"]) == ("Danger", "Do It")
    assert options["cancel_default"] is True
    assert (result, operator.done) == ({"RUNNING_MODAL"}, 0)
    labels: list[str] = []
    layout = SimpleNamespace(
        column=lambda **k: layout, label=lambda text, icon: labels.append(text)
    )
    operator.layout = layout
    operator.draw(None)
    assert "".join(labels).replace(" ", "") == (text + "And the object.").replace(" ", "")


def test_no_dialog_without_loss() -> None:
    """It acts immediately; an error is a report, and nothing is done."""
    operator = Danger()
    assert invoked(operator) == ({"FINISHED"}, [])
    assert (operator.done, operator.reports) == (1, [({"INFO"}, "done")])
    operator = Danger("x", problem="No, because.")
    assert invoked(operator) == ({"CANCELLED"}, [])
    assert (operator.done, operator.reports) == (0, [({"ERROR"}, "No, because.")])


@pytest.mark.parametrize("cls", [Train, DiscardTraining, PredictDepth, MakeEnvironment])
def test_operators_that_need_confirmation(cls: type) -> None:
    """Operators that cannot be undone."""
    assert issubclass(cls, ConfirmMixin) and issubclass(cls, BaseOperator)
    assert cls.confirm != ConfirmMixin.confirm

"""Tensors are made with a dtype and a device of their own; oracle: the syntax trees.

Torch's defaults belong to whoever runs gscore. Memory of another dtype or device than was meant
comes out of a factory without a word.
"""

import ast
from pathlib import Path

from tests.for_each import for_each
from tests.source_rules import Source

PACKAGE = Path(__file__).parent.parent / "gscore"
_NAMES = """arange as_tensor empty eye full linspace logspace normal ones rand randint randn
    randperm scalar_tensor tensor zeros"""
FACTORIES = {f"torch.{name}" for name in _NAMES.split()}
BY_TENSOR = {PACKAGE / "raster" / "reference", PACKAGE / "stress"}
"""Definitions to compare with, which take dtype and device of what they are given."""


def _files() -> list[Path]:
    return [p for p in sorted(PACKAGE.rglob("*.py")) if not BY_TENSOR & set(p.parents)]


def _unnamed(path: Path) -> list[str]:
    found = []
    for site, call in Source(path.read_text(encoding="utf-8")).calls():
        given = {word.arg for word in call.keywords}
        if site.callee == "torch.Generator" and not given & {"device"}:
            found.append(f"line {site.line}: {site.callee} without device")
        if site.callee in FACTORIES and not given >= {"dtype", "device"}:
            found.append(f"line {site.line}: {site.callee} without dtype and device")
    return found


@for_each(_files())
def test_no_tensor_is_made_by_torchs_defaults(path: Path) -> None:
    """Oracle: the keywords of every call of a factory."""
    assert _unnamed(path) == []


def test_the_rule_finds_what_it_looks_for(tmp_path: Path) -> None:
    """Oracle: a line that breaks it and one that does not."""
    file = tmp_path / "a.py"
    file.write_text("import torch\na = torch.zeros(3)\n", encoding="utf-8")
    assert _unnamed(file) == ["line 2: torch.zeros without dtype and device"]
    file.write_text("import torch as t\nt.ones(3, dtype=t.float32, device='cpu')\n", "utf-8")
    assert _unnamed(file) == [] and ast.parse(file.read_text("utf-8"))

"""Texts of the add-on are spelled as Blender's own. Oracle: American forms of common words."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import bpy

import addon

BRITISH = re.compile(r"colour|grey|metres|centre|neighbour", re.IGNORECASE)
ADDON = Path(addon.__file__).parent


def sentences(tree: ast.AST) -> Iterator[str]:
    """Texts with a space, without documentation."""
    documentation = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        text = node.value if isinstance(node, ast.Constant) else None
        if isinstance(text, str) and " " in text and node not in documentation:
            yield text


def test_messages_and_labels() -> None:
    """Messages, and names and descriptions of properties."""
    texts = (t for p in ADDON.rglob("*.py") for t in sentences(ast.parse(p.read_text("utf-8"))))
    assert not [text for text in texts if BRITISH.search(text)]


def test_tooltips() -> None:
    """Descriptions of operators, which are their documentation."""
    names = dir(bpy.ops.gscore)
    texts = [getattr(bpy.ops.gscore, name).get_rna_type().description for name in names]
    assert texts and all(texts)
    assert not [text for text in texts if BRITISH.search(text)]

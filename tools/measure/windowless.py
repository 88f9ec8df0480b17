"""Stand-in for a window: runs the add-on's incremental operators to the end without one."""

import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import bpy

INTERVAL = 0.01
"""Seconds between two steps in a window."""


def windowless(name: str, **settings: Any) -> Any:
    """An instance of an operator's Python class with its settings, outside of Blender's operator
    system: `steps` works as from a button, and `reports` collects its reports.

    Args:
        name: Name in `bpy.ops.gscore`.
        settings: Settings that differ from the defaults.
    """
    cls = getattr(bpy.types, f"GSCORE_OT_{name}")
    bases = tuple(base for base in cls.__bases__ if base is not bpy.types.Operator)
    own = {key: value for key, value in vars(cls).items() if key not in ("__dict__", "bl_rna")}
    made = type(cls.__name__, bases, own)()
    for prop in getattr(bpy.ops.gscore, name).get_rna_type().properties:
        if hasattr(prop, "default"):
            several = getattr(prop, "is_array", False)
            setattr(made, prop.identifier, prop.default_array[:] if several else prop.default)
    for key, value in settings.items():
        setattr(made, key, value)
    made.properties = SimpleNamespace(is_property_set=settings.__contains__)
    made.options = SimpleNamespace(is_invoke=True)
    made.reports = []
    made.report = lambda kinds, text: made.reports.append(text)
    return made


def steps(going: Any) -> Iterator[tuple[float, float]]:
    """Run a task as in a window. For each step: CPU seconds of the calling thread, which other
    programs do not affect, and the delay of the wake-up after it, seconds."""
    done = False
    while not done:
        began = time.thread_time()
        done = going.step()
        ended = time.thread_time()
        late = 0.0
        for _ in range(round(INTERVAL / 0.002)):
            due = time.perf_counter() + 0.002
            time.sleep(0.002)
            late = max(late, time.perf_counter() - due)
        yield ended - began, late

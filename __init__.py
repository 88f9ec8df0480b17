"""Entry point of the Blender extension, which is this folder. Empty outside Blender."""

import sys

if __name__.startswith("bl_ext."):
    # After an update in a running session Blender keeps what came from the wheels before.
    for _name in [name for name in sys.modules if name.split(".")[0] == "gscore"]:
        del sys.modules[_name]

try:
    import bpy  # noqa: F401
except ImportError:  # a test run that imports the folders above its tests
    pass
else:
    from .addon import register, unregister

    __all__ = ["register", "unregister"]

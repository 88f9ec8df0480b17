"""Entry point of the Blender extension, which is this folder. Empty outside Blender."""

try:
    import bpy  # noqa: F401
except ImportError:  # a test run that imports the folders above its tests
    pass
else:
    from .addon import register, unregister

    __all__ = ["register", "unregister"]

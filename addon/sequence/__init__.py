"""Sequences of captures, such as multi-view videos, trained frame by frame beside Blender."""

"""Facts about a capture for the panel; no bpy."""

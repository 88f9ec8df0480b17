"""What a capture's folder holds; no bpy."""

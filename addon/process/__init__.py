"""What runs beside Blender, and the beat that follows it."""

"""Shared code of operators and panels: base operators, undo, images, icons, text in views."""

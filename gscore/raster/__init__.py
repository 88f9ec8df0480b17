"""Rasterizer: the native library, its torch wrapper and its float64 twin."""

"""Browser page that shows splats: a single HTML file.

`pack` compresses splats and encodes the bytes as text, `page` assembles the file. Scripts
and shaders for the browser are separate files in this folder.
"""

"""Browser page that shows splats: a single HTML file.

`pack` and `ascii85` make few bytes of splats and text of the bytes, `page` puts the file together.
What runs in the browser lies beside them, as files of its own.
"""

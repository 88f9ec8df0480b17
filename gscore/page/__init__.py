"""A page that shows splats in a browser: one file, nothing loaded from elsewhere.

`pack` and `ascii85` make few bytes of splats and text of the bytes, `page` puts the file together.
What runs in the browser lies beside them, as files of its own.
"""

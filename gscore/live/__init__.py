"""Viewer server: the network protocol of the SIBR viewer of 3DGS, over TCP.

`viewer_protocol` parses messages, `server` handles connections; a training uses `viewer_clients`.
"""

"""Viewer server: the network protocol of the SIBR viewer of 3DGS, over TCP.

`protocol` knows the messages, `server` the connections; the training meets `onlookers`.
"""

"""A training watched by viewers: the remote protocol of the 3DGS authors' viewer, over TCP.

`protocol` knows the messages, `server` the connections; the training meets `onlookers`.
"""

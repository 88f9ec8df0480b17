"""Multi-view video in the layouts of PKU-DyMVHumans."""

"""Parts of make_studio.py: figure, stage, cameras, rendering, reconstruction."""

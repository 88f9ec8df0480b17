"""What has started this process."""

import os


def under_torchrun() -> bool:
    """Whether torchrun, or what speaks as it does, has started this process."""
    return {"RANK", "WORLD_SIZE"} <= os.environ.keys()

"""torchrun launch: detection of processes that torchrun started."""

import os


def under_torchrun() -> bool:
    """Whether torchrun, or what speaks as it does, has started this process."""
    return {"RANK", "WORLD_SIZE"} <= os.environ.keys()


def one_of_many() -> bool:
    """Whether it has started others besides."""
    return under_torchrun() and os.environ["WORLD_SIZE"] not in ("0", "1")

"""torchrun launch: detection of processes that torchrun started."""

import os


def under_torchrun() -> bool:
    """Whether torchrun, or a launcher with its environment variables, started this process."""
    return {"RANK", "WORLD_SIZE"} <= os.environ.keys()


def is_worker() -> bool:
    """Whether another process, rank 0, writes the output of the command."""
    return under_torchrun() and os.environ["RANK"] != "0"


def one_of_many() -> bool:
    """Whether it started other processes too."""
    return under_torchrun() and os.environ["WORLD_SIZE"] not in ("0", "1")

"""What the ranks found in their photos, compared before anything is learnt of them."""

from ...errors import DatasetError, GsError
from .team import Team


def fail(team: Team, error: GsError) -> None:
    """Tell the others that this rank's photo cannot be had."""
    team.numbers([1.0, 0.0, 0.0, 0.0, *team.account])
    team.texts(str(error))
    team.told = True


def of_all(
    team: Team, value: float, mse: float, *, photos: int, mark: float
) -> tuple[list[float], list[float]]:
    """The loss and the mean squared error of each photo of the batch, in the order of the ranks.

    Args:
        team: All take part.
        value: The loss of this rank's photo.
        mse: Its mean squared error.
        photos: How many there are in this batch.
        mark: A number that must be the same on all ranks.

    Raises:
        DatasetError: a rank cannot have its photo, see `fail`.
        GsError: the marks differ.
    """
    found = team.numbers([0.0, value, mse, mark, *team.account])
    team.accounts = found[:, 4:]
    if found[:, 0].any():
        rank, texts = int(found[:, 0].argmax()), team.texts("")
        team.told = True
        raise DatasetError(f"Rank {rank}: {texts[rank]}")
    if (found[:, 3] != mark).any() or (found[:, 3] != found[0, 3]).any():
        rank = int((found[:, 3] != found[0, 3]).argmax())
        team.told = True
        raise GsError(
            f"Rank {rank} has other splats than rank 0, after the same steps: its machine computes "
            "otherwise. Start again with --resume on machines of one kind, or with GSCORE_ISA and "
            "ATEN_CPU_CAPABILITY set to what all have."
        )
    return found[:photos, 1].tolist(), found[:photos, 2].tolist()

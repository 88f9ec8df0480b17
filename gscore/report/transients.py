"""Transients in the report: photos with the parts that the training left out."""

import html
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from .html_parts import MOST_ROWS, photo_table
from .pictures import data_uri, shrink, size_within

MOST_PICTURES = 10
"""Maximum number of pictures, of the photos with the largest parts."""
_WIDTH = 320
"""Longer side of a picture, px."""
_RED = np.array([230, 30, 30])
"""Colour of what is left out, half of a pixel's."""


class MaskedPhoto(NamedTuple):
    """A photo with its transients in red."""

    name: str
    uri: str
    """`data:image/jpeg;base64,...`."""
    width: int
    height: int

    @classmethod
    def of(cls, name: str, photo: np.ndarray, mask: np.ndarray) -> "MaskedPhoto":
        """The picture of a photo, [H, W, 3] uint8; `mask`: [H, W] uint8, 0 where it is left out."""
        width, height = size_within(photo.shape[1], photo.shape[0], _WIDTH)
        picture, shown = shrink(photo, (width, height)), shrink(mask, (width, height))
        red = np.where(shown[..., None] < 128, (picture + _RED) // 2, picture)
        return cls(name, data_uri(red.astype(np.uint8)), width, height)


def transients_html(shares: Mapping[str, float], masked: Sequence[MaskedPhoto]) -> str:
    """The section.

    Args:
        shares: Parts of photos that were left out, by name.
        masked: Pictures of some of them.
    """
    rows = {name: (share, f"{100 * share:.1f} %") for name, share in shares.items()}
    more = f" Largest {MOST_ROWS} of {len(shares)}." if len(shares) > MOST_ROWS else ""
    red = " They are red in the pictures of the largest." if masked else ""
    figures = "".join(
        f'<figure><img loading="lazy" width="{one.width}" height="{one.height}" src="{one.uri}" '
        f'alt="{html.escape(one.name)}, transients in red">'
        f"<figcaption>{html.escape(one.name)}</figcaption></figure>"
        for one in masked
    )
    return (
        '<section id="transients"><h2>Transients</h2><p class="hint">Parts of photos that other '
        "photos contradict, such as people, cars and shadows. The training left them out; "
        f"`--no-transient-masks` trains on them.{red}{more}</p>"
        + (f'<div class="five">{figures}</div>' if figures else "")
        + f"{photo_table(('left out',), rows)}</section>\n"
    )

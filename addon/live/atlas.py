"""Texture atlas of splats for the graphics card, sorted by contribution; no bpy, no gpu."""

from dataclasses import dataclass, replace

import numpy as np

from ..core import Splats, quat_to_rotmat

COLUMNS = 1024
"""Splats in a row of the texture."""
TEXELS = 3
"""Texels of four floats per splat: mean and opacity; covariance xx, xy, xz, yy; covariance yz, zz,
index of the object, unused."""
MOST = 1 << 24
"""Most splats whose indices float32 represents exactly."""
_BLOCK = 1 << 16


@dataclass(frozen=True, kw_only=True)
class Atlas:
    """All splats of a view. A prefix is drawn if there is no time for all."""

    parts: tuple[Splats, ...]
    """Splats of each object, in its own space."""
    part: np.ndarray
    """[N] int32, index of the object of each row."""
    index: np.ndarray
    """[N] int32, index of the splat within its object."""
    texels: np.ndarray
    """[R, COLUMNS, TEXELS, 4] float32, row by row; padded with zeros."""

    def __len__(self) -> int:
        return len(self.part)

    @property
    def means(self) -> np.ndarray:
        """[N, 3] float32 view, in the objects' spaces."""
        return self.texels.reshape(-1, TEXELS, 4)[: len(self), 0, :3]


def build(parts: list[Splats]) -> Atlas:
    """Build the atlas of some objects.

    Raises:
        ValueError: there are more than `MOST` splats.
    """
    total = sum(len(p) for p in parts)
    if total > MOST:
        raise ValueError(
            f"{total:,} splats are too many for this view, whose limit is {MOST:,}: hide some "
            "objects."
        )
    part = np.repeat(np.arange(len(parts), dtype=np.int32), [len(p) for p in parts])
    index = np.concatenate([np.arange(len(p), dtype=np.int32) for p in parts])
    order = np.argsort(-np.concatenate([weight(p) for p in parts]), kind="stable")
    part, index = part[order], index[order]
    rows = -(-max(total, 1) // COLUMNS)
    texels = np.zeros((rows * COLUMNS, TEXELS, 4), np.float32)
    for number, splats in enumerate(parts):
        places = np.flatnonzero(part == number)
        for at in range(0, len(places), _BLOCK):
            here = places[at : at + _BLOCK]
            texels[here] = _texels(splats, index[here], number)
    shaped = texels.reshape(rows, COLUMNS, TEXELS, 4)
    return Atlas(parts=tuple(parts), part=part, index=index, texels=shaped)


def repainted(atlas: Atlas, parts: list[Splats]) -> tuple[Atlas, np.ndarray] | None:
    """The atlas of the same objects after colours and opacities have changed.

    Rows keep their order, although it depends on opacities. None if more has changed, that is, if
    other arrays are not the same objects as in `atlas.parts`.

    Returns:
        The atlas, with shared texels if all opacities are the same, and the rows that differ, [N]
        bool.
    """
    if len(parts) != len(atlas.parts) or not all(map(_same_shapes, atlas.parts, parts)):
        return None
    differ = np.zeros(len(atlas), bool)
    texels = atlas.texels
    for number, (before, after) in enumerate(zip(atlas.parts, parts, strict=True)):
        if before is after:
            continue
        rows = np.flatnonzero(atlas.part == number)
        index = atlas.index[rows]
        fades = before.opacities != after.opacities
        differ[rows] = (fades | (before.sh0[:, 0] != after.sh0[:, 0]).any(axis=1))[index]
        if fades.any():
            texels = texels.copy() if texels is atlas.texels else texels
            here = fades[index]
            opacities = opacity(after.opacities[index[here]])
            texels.reshape(-1, TEXELS, 4)[rows[here], 0, 3] = opacities
    return replace(atlas, parts=tuple(parts), texels=texels), differ


def _same_shapes(before: Splats, after: Splats) -> bool:
    return all(getattr(before, n) is getattr(after, n) for n in ("means", "quats", "scales", "shN"))


def weight(splats: Splats) -> np.ndarray:
    """Approximate contribution of splats, [N] float32: opacity times largest projected area."""
    scales = np.sort(splats.scales, axis=1)
    return opacity(splats.opacities) * np.exp(np.clip(scales[:, 1] + scales[:, 2], -80, 80))


def opacity(logits: np.ndarray) -> np.ndarray:
    """Sigmoid, float32."""
    return (1 / (1 + np.exp(-np.clip(logits, -80, 80)))).astype(np.float32)


def _texels(splats: Splats, index: np.ndarray, number: int) -> np.ndarray:
    """Texels [B, TEXELS, 4] of some splats of an object."""
    scales = np.exp(np.clip(splats.scales[index], -40, 40))
    axes = quat_to_rotmat(splats.quats[index]).astype(np.float32) * scales[:, None, :]
    covariance = axes @ axes.transpose(0, 2, 1)
    out = np.zeros((len(index), TEXELS, 4), np.float32)
    out[:, 0, :3], out[:, 0, 3] = splats.means[index], opacity(splats.opacities[index])
    out[:, 1, :3], out[:, 1, 3] = covariance[:, 0], covariance[:, 1, 1]
    out[:, 2, 0], out[:, 2, 1] = covariance[:, 1, 2], covariance[:, 2, 2]
    out[:, 2, 2] = number
    return out

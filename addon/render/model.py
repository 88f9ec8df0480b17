"""Model of a render: all placed splat objects as one set of splats, cached; no bpy."""

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from .. import attributes
from ..core import Splats, sh_basis, transform_splats
from ..interface.option_labels import error_text
from .mesh_copies import FrozenMesh, Trace, repainted_rows, trace_of
from .relight import relit, shortest_axes
from .scene import Identity, Placed

HALF = float(0.5 / sh_basis(0, np.array([0.0, 0.0, 1.0]))[0])
"""Difference in sh0 from grey to white, and from black to grey."""


@dataclass(frozen=True, kw_only=True)
class Model:
    """Splats of a picture, merged from all objects."""

    splats: Splats
    """Splats in the space of the object with the most splats, which needs no transformation."""
    matrix: np.ndarray
    """[4, 4] float64, similarity from that space to the world."""
    antialias: tuple[str, ...]
    """Names of the objects that were trained with anti-aliasing."""
    plain: tuple[str, ...]
    """Names of the others."""
    owners: tuple[tuple[Identity | None, int], ...] = ()
    """Owners of consecutive runs of `splats`, and the runs' lengths; None: a holdout."""
    shares: Splats | None = None
    """The same splats with holdouts black and all others white; None: no holdouts. Their
    picture is the share of light that is not cut out."""
    values: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Values of the splats for passes by the names of `splat_values`, [N, ...]."""

    def subset(self, kept: np.ndarray) -> "Model":
        """The splats of a mask [N]; without owners."""
        return replace(
            self,
            splats=self.splats.subset(kept),
            owners=(),
            shares=None if self.shares is None else self.shares.subset(kept),
            values={name: values[kept] for name, values in self.values.items()},
        )


class SplatCache:
    """Decoded splats by object, and the last merged model. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._parts: dict[tuple[int, bytes], tuple[Trace, Splats]] = {}
        self._relit: dict[tuple[int, bytes], tuple[Splats, Splats]] = {}
        """Splats as captured, and relit, by `Placed.part`."""
        self._merged: tuple[list[tuple[Splats, np.ndarray]], Splats] | None = None
        self._holdouts: tuple[Splats, list[tuple[int, bool]], tuple[Splats, Splats]] | None = None
        self.decoded = 0
        """Number of decoded objects, for measurements."""
        self.merged = 0
        """Number of merges of several objects, for measurements."""

    def clear(self) -> None:
        """Drop all splats."""
        with self._lock:
            self._parts, self._relit, self._merged, self._holdouts = {}, {}, None, None

    def model(self, placed: list[Placed]) -> Model:
        """One model of all objects; only changes since the last call are computed.

        Raises:
            ValueError: attributes are missing or not finite, or an object is scaled unevenly; the
                object is named.
        """
        with self._lock:
            parts = self._decoded(placed)
            base = max(placed, key=lambda p: len(parts[p.part]))
            inverse = np.linalg.inv(base.matrix)
            turned = [
                (parts[p.part], np.eye(4) if p is base else inverse @ p.matrix) for p in placed
            ]
            splats, shares = self._merge(turned), None
            counts = [len(parts[p.part]) for p in placed]
            if any(p.holdout for p in placed):
                runs = [(n, p.holdout) for n, p in zip(counts, placed, strict=True)]
                last = self._holdouts
                if last is None or last[0] is not splats or last[1] != runs:
                    self._holdouts = last = splats, runs, apply_holdout(splats, runs)
                splats, shares = last[2]
        owners = [None if p.holdout else p.identity for p in placed]
        return Model(
            splats=splats,
            owners=tuple(zip(owners, counts, strict=True)),
            shares=shares,
            matrix=base.matrix,
            antialias=tuple(p.name for p in placed if p.antialias),
            plain=tuple(p.name for p in placed if not p.antialias),
        )

    def parts(self, placed: list[Placed]) -> list[Splats]:
        """The splats of each object in its own space; errors as `model`."""
        with self._lock:
            found = self._decoded(placed)
        return [found[p.part] for p in placed]

    def _decoded(self, placed: list[Placed]) -> dict[tuple[int, bytes], Splats]:
        """Splats by `Placed.part`; drops all others."""
        for p in placed:
            check_similar(p)
        captured = {p.captured: self._decode(p) for p in placed}
        self._parts = {key: known for key, known in self._parts.items() if key in captured}
        parts = {p.part: self._relight(captured[p.captured], p) for p in placed}
        self._relit = {key: known for key, known in self._relit.items() if key in parts}
        return parts

    def _relight(self, captured: Splats, placed: Placed) -> Splats:
        if placed.relighting is None:
            return captured
        known = self._relit.get(placed.part)
        if known is None or known[0] is not captured:
            self._relit[placed.part] = known = captured, _relit(captured, placed)
        return known[1]

    def _decode(self, placed: Placed) -> Splats:
        known = self._parts.get(placed.captured)
        if known is not None and known[0].fingerprint == placed.frozen.fingerprint:
            return known[1]
        made = None if known is None else _repainted(*known, placed)
        if made is None:
            made = decoded(placed)
            self.decoded += 1
        self._parts[placed.captured] = made
        return made[1]

    def _merge(self, turned: list[tuple[Splats, np.ndarray]]) -> Splats:
        """Splats, each with the matrix to the common space, as one model."""
        if len(turned) == 1:
            self._merged = None
            return turned[0][0]
        same = self._merged is not None and len(self._merged[0]) == len(turned)
        if same:
            pairs = zip(self._merged[0], turned, strict=True)
            same = all(a is b and np.array_equal(m, n) for (a, m), (b, n) in pairs)
        if not same:
            moved = [s if np.array_equal(m, np.eye(4)) else _moved(s, m) for s, m in turned]
            self._merged = turned, _concatenated(moved)
            self.merged += 1
        return self._merged[1]


def decoded(placed: Placed) -> tuple[Trace, Splats]:
    """The splats of an object that pass its filters, and the trace of its copy."""
    splats, kept = placed.frozen.read(), None
    if placed.filters is not None:
        kept = placed.frozen.kept(placed.filters)
        splats = splats.subset(kept)
    return trace_of(placed.frozen, kept), splats


def _relit(captured: Splats, placed: Placed) -> Splats:
    """The splats of an object under the light of its scene."""
    return relit(captured, *surface_of(placed, captured), placed.relighting)


def surface_of(placed: Placed, captured: Splats) -> tuple[np.ndarray, np.ndarray | None]:
    """Normals of the splats of an object, and the captured light if it was estimated, as `relit`
    takes them."""
    frozen = placed.frozen
    if not (isinstance(frozen, FrozenMesh) and frozen.can_be_relit):
        return shortest_axes(captured.quats, captured.scales), None
    columns = (frozen.columns[name] for name in (attributes.NORMAL, attributes.CAPTURED))
    if placed.filters is None:
        return tuple(columns)
    kept = frozen.kept(placed.filters)
    return tuple(column[kept] for column in columns)


def _repainted(before: Trace, splats: Splats, placed: Placed) -> tuple[Trace, Splats] | None:
    """Like `decoded`, if only colours and opacities have changed; all other arrays are shared with
    `splats`.

    Args:
        before: Trace of the copy that `splats` were decoded from, with the current filters.
        splats: The earlier splats.
        placed: The object.

    Returns:
        None if more has changed, or if other splats pass the filters.
    """
    rows = repainted_rows(before, placed.frozen)
    if rows is None:
        return None
    assert isinstance(placed.frozen, FrozenMesh)
    base, among = placed.frozen.base[rows], rows
    if placed.filters is not None:
        kept = placed.frozen.kept(placed.filters)
        if not np.array_equal(kept, before.kept):
            return None
        base, among = base[kept[rows]], (np.cumsum(kept) - 1)[rows[kept[rows]]]
    after = trace_of(placed.frozen, before.kept)
    return after, attributes.repainted(splats, among, base)


def check_similar(placed: Placed) -> None:
    """Raise ValueError, which names the object, if its matrix is not a similarity; quick enough for
    every redraw."""
    if problem := _refusal(placed.matrix.tobytes()):
        raise ValueError(f"{placed.name} cannot be rendered. {problem}")


@lru_cache(maxsize=1024)
def _refusal(matrix: bytes) -> str:
    """Why splats cannot be transformed by a matrix [4, 4] float64; empty if they can."""
    try:
        transform_splats(attributes.NO_SPLATS, np.frombuffer(matrix).reshape(4, 4))
    except ValueError as error:
        return error_text(error)
    return ""


def _moved(splats: Splats, matrix: np.ndarray) -> Splats:
    matrix[3] = 0, 0, 0, 1  # exact, despite the rounding of an inversion
    return transform_splats(splats, matrix)


def _concatenated(parts: list[Splats]) -> Splats:
    """One model; SH of lower degrees are padded with zeros, which changes nothing."""
    rest = max(p.shN.shape[1] for p in parts)
    padded = [np.pad(p.shN, ((0, 0), (0, rest - p.shN.shape[1]), (0, 0))) for p in parts]
    names = ("means", "quats", "scales", "opacities", "sh0")
    joined = {n: np.concatenate([getattr(p, n) for p in parts]) for n in names}
    return Splats(**joined, shN=np.concatenate(padded))


def apply_holdout(splats: Splats, runs: list[tuple[int, bool]]) -> tuple[Splats, Splats]:
    """Splats of which some cut holes.

    Args:
        splats: All splats.
        runs: Lengths of consecutive runs, and whether the run cuts holes.

    Returns:
        The splats with holdouts in black; and the splats whose picture is the share of light that
        is not cut out: holdouts black, others white, without view dependence.
    """
    cuts = np.repeat([cut for _, cut in runs], [count for count, _ in runs])[:, None, None]
    sh0 = np.where(cuts, np.float32(-HALF), splats.sh0)
    rest = np.where(cuts, np.float32(0), splats.shN)
    share = np.repeat(np.where(cuts, np.float32(-HALF), np.float32(HALF)), 3, axis=2)
    return (
        replace(splats, sh0=sh0, shN=rest),
        replace(splats, sh0=share, shN=np.zeros_like(rest[:, :0])),
    )

"""Image retrieval: similar photos by visual words of their own features, without a network.

A bag of visual words (Sivic and Zisserman 2003): features are put into as many groups as there are
words, and photos that share words which few others have are alike.
"""

import numpy as np

_SEED = 0
_SAMPLED = 400
"""Features of a photo that are looked at, at most."""
_WORDS = 1024
_LEARNT = 20_000
"""Features that words are made of, at most."""
_ROUNDS = 5
"""Of k-means."""
_BLOCK = 8192
"""Features that are compared with all words at a time."""


def most_similar(descriptors: list[np.ndarray], count: int) -> np.ndarray:
    """[n, count] int64: for each photo the others, the most alike first; -1 where none is left that
    shares a word.

    Args:
        descriptors: Of each photo, [m, d], any number type; m may be 0.
        count: How many, less than there are photos.
    """
    rng = np.random.default_rng(_SEED)
    sampled = [_some(each, _SAMPLED, rng).astype(np.float32) for each in descriptors]
    joined = np.concatenate(sampled)
    owners = np.repeat(np.arange(len(sampled)), [len(each) for each in sampled])
    if not len(joined):
        return np.full((len(sampled), count), -1)
    words = _nearest(joined, _vocabulary(_some(joined, _LEARNT, rng), rng))
    likeness = _likeness(owners, words, len(sampled))
    np.fill_diagonal(likeness, 0.0)
    order = np.argsort(-likeness, axis=1, kind="stable")[:, :count]
    return np.where(np.take_along_axis(likeness, order, axis=1) > 0, order, -1)


def _likeness(owners: np.ndarray, words: np.ndarray, photos: int) -> np.ndarray:
    """[n, n] cosines between the photos' counts of words, where rare words weigh more."""
    counts = np.zeros((photos, _WORDS))
    np.add.at(counts, (owners, words), 1.0)
    having = (counts > 0).sum(axis=0)
    weighed = np.sqrt(counts) * np.log(photos / np.maximum(having, 1))
    weighed /= np.maximum(np.linalg.norm(weighed, axis=1, keepdims=True), 1e-12)
    return weighed @ weighed.T


def _vocabulary(learnt: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """[w, d] float32, middles of groups of features (k-means); at most `_WORDS`."""
    middles = _some(learnt, _WORDS, rng)
    for _ in range(_ROUNDS):
        groups = _nearest(learnt, middles)
        sizes = np.bincount(groups, minlength=len(middles))
        sums = np.zeros_like(middles)
        np.add.at(sums, groups, learnt)
        middles = np.where(sizes[:, None] > 0, sums / np.maximum(sizes, 1)[:, None], middles)
    return middles


def _nearest(features: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """[m] int64: the middle nearest to each feature."""
    half = 0.5 * (middles**2).sum(axis=1)
    parts = [features[i : i + _BLOCK] for i in range(0, len(features), _BLOCK)]
    return np.concatenate([np.argmin(half - part @ middles.T, axis=1) for part in parts])


def _some(rows: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    """At most so many of the rows, in their order."""
    if len(rows) <= most:
        return rows
    return rows[np.sort(rng.choice(len(rows), most, replace=False))]

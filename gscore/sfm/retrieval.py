"""Image retrieval: similar photos by visual words of their own features, without a network.

A bag of visual words (Sivic and Zisserman 2003): each feature is assigned to a cluster, its word;
photos that share rare words are similar.
"""

import numpy as np

_SEED = 0
_SAMPLED = 400
"""Maximum number of features used per photo."""
_WORDS = 1024
_CLUSTERED = 20_000
"""Maximum number of features for the vocabulary."""
_ROUNDS = 5
"""Iterations of k-means."""
_BLOCK = 8192
"""Number of features compared with all words at a time."""


def most_similar(descriptors: list[np.ndarray], count: int) -> np.ndarray:
    """Indices [n, count] int64 of the photos most similar to each photo, best first; -1 where no
    other photo shares a word.

    Args:
        descriptors: Descriptors of each photo, [m, d], any number type; m may be 0.
        count: Number per photo, less than the number of photos.
    """
    rng = np.random.default_rng(_SEED)
    sampled = [_some(each, _SAMPLED, rng).astype(np.float32) for each in descriptors]
    joined = np.concatenate(sampled)
    owners = np.repeat(np.arange(len(sampled)), [len(each) for each in sampled])
    if not len(joined):
        return np.full((len(sampled), count), -1)
    words = _nearest(joined, _vocabulary(_some(joined, _CLUSTERED, rng), rng))
    similarity = _similarity(owners, words, len(sampled))
    np.fill_diagonal(similarity, 0.0)
    order = np.argsort(-similarity, axis=1, kind="stable")[:, :count]
    return np.where(np.take_along_axis(similarity, order, axis=1) > 0, order, -1)


def _similarity(owners: np.ndarray, words: np.ndarray, photos: int) -> np.ndarray:
    """Cosine similarities [n, n] of the photos' word counts, with inverse document frequency."""
    counts = np.zeros((photos, _WORDS))
    np.add.at(counts, (owners, words), 1.0)
    having = (counts > 0).sum(axis=0)
    weighed = np.sqrt(counts) * np.log(photos / np.maximum(having, 1))
    weighed /= np.maximum(np.linalg.norm(weighed, axis=1, keepdims=True), 1e-12)
    return weighed @ weighed.T


def _vocabulary(features: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Cluster centres [w, d] float32 of features (k-means); w is at most `_WORDS`."""
    centers = _some(features, _WORDS, rng)
    for _ in range(_ROUNDS):
        clusters = _nearest(features, centers)
        sizes = np.bincount(clusters, minlength=len(centers))
        sums = np.zeros_like(centers)
        np.add.at(sums, clusters, features)
        centers = np.where(sizes[:, None] > 0, sums / np.maximum(sizes, 1)[:, None], centers)
    return centers


def _nearest(features: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Index [m] int64 of the centre nearest to each feature."""
    half = 0.5 * (centers**2).sum(axis=1)
    parts = [features[i : i + _BLOCK] for i in range(0, len(features), _BLOCK)]
    return np.concatenate([np.argmin(half - part @ centers.T, axis=1) for part in parts])


def _some(rows: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    """A random sample of at most `most` rows, in their order."""
    if len(rows) <= most:
        return rows
    return rows[np.sort(rng.choice(len(rows), most, replace=False))]

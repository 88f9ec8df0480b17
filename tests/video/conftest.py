"""One video for most tests: a walk with shaken, frozen and still stretches."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from . import films


@dataclass(frozen=True)
class Film:
    """A video and the effects on each of its frames."""

    path: Path
    kinds: list[str]
    places: np.ndarray
    """[n] float64, true path of the camera in shares of the picture's width."""
    pictures: list[np.ndarray]


@pytest.fixture(scope="session")
def film(tmp_path_factory: pytest.TempPathFactory) -> Film:
    """240 frames: every tenth blurred, 15 shaken, 30 of a trembling stand, 10 held."""
    texture = films.wall(2400)
    rng = np.random.default_rng(1)
    pictures, kinds, places, x = [], [], [], 4.0
    for i in range(240):
        kind, blur, shift = "sharp", 1, 0
        if 60 <= i < 75:
            kind, blur = "shaken", 18
        elif 120 <= i < 150:
            kind, shift = "still", int(rng.integers(-2, 3))
        elif 180 <= i < 190:
            kind = "held"
        elif i % 10 == 3:
            kind, blur = "shaken", 6
        x += 0 if kind in ("still", "held") else 8
        held = kind == "held"
        pictures.append(pictures[-1] if held else films.seen(texture, x + shift, blur=blur))
        kinds.append(kind)
        places.append(x / films.WIDTH)
    path = films.write(tmp_path_factory.mktemp("film") / "walk.mp4", pictures)
    return Film(path, kinds, np.array(places), pictures)

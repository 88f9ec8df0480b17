"""Frames chosen from a video: the true path of its camera, and the effects on frames."""

import numpy as np
import pytest

from gscore.errors import Cancelled
from gscore.video.extract import choose
from gscore.video.frame_survey import AccumulatedMotion, Survey, survey
from gscore.video.source import opened_video

from . import films
from .conftest import Film


@pytest.fixture(scope="module")
def looked(film: Film) -> Survey:
    with opened_video(film.path) as video:
        return survey(video, on_frame=lambda count: None, cancelled=lambda: False)


def test_the_way_is_the_cameras(film: Film, looked: Survey) -> None:
    """Oracle: the places that the pictures were cut out at."""
    true = film.places - film.places[0]
    assert np.abs(looked.travel - true).max() < 0.05  # of 3.3 picture widths
    assert looked.travel[-1] == pytest.approx(true[-1], rel=0.02)
    assert (np.diff(looked.travel) >= 0).all()


def test_trembling_does_not_add_up(film: Film, looked: Survey) -> None:
    """Oracle: a camera that trembles by two pixels for a second, with a path of a few of them."""
    still = [i for i, kind in enumerate(film.kinds) if kind == "still"]
    assert looked.travel[still[-1]] - looked.travel[still[0]] < 6 / films.WIDTH


def test_held_frames_are_known(film: Film, looked: Survey) -> None:
    """Oracle: the frames that were written twice."""
    held = {i for i, kind in enumerate(film.kinds) if kind == "held"}
    among_others = np.flatnonzero(looked.repeated)
    assert held <= set(among_others)
    assert all(film.kinds[i] in ("held", "still") for i in among_others)


@pytest.mark.parametrize("count", [12, 40, 0])
def test_frames_are_sharp_and_evenly_spread(film: Film, looked: Survey, count: int) -> None:
    """Oracle: no shaken or repeated frame; steps of the true path near their median."""
    choice = choose(looked, count)
    kinds = [film.kinds[i] for i in choice.frames]
    assert "shaken" not in kinds and "held" not in kinds
    assert kinds.count("still") <= 1
    expected = count or 63  # one each 5 % of 3.3 widths, the shake at the usual speed
    assert expected - 3 <= len(choice.frames) <= expected
    steps = np.diff(film.places[choice.frames])
    usual = np.median(steps)
    wide = steps > 2 * usual
    assert wide.sum() <= 1  # where all frames are shaken
    assert steps[~wide].min() > 0.3 * usual


def test_blurred_parts_are_reported(film: Film, looked: Survey) -> None:
    """Oracle: frames 60 to 75 of 30 a second are shaken."""
    ((begin, end),) = choose(looked, 0).gaps
    assert 1.8 <= begin <= 2.0 and 2.5 <= end <= 2.7


def test_the_sharpest_of_a_piece_is_taken() -> None:
    """Oracle: by hand: one frame of each ten is twice as sharp as the others."""
    n = 100
    fine = np.full(n, 60.0)
    best = np.arange(4, n, 10)
    fine[best] = 120.0
    made = Survey(
        seconds=np.arange(n) / 30,
        travel=np.arange(n) / n,
        fine=fine,
        coarse=np.ones(n),
        repeated=np.zeros(n, bool),
    )
    assert choose(made, 10).frames.tolist() == best.tolist()


def test_a_turn_too_fast_to_follow_counts_as_far() -> None:
    """Oracle: pictures of different places, without a displacement although the camera moves."""
    travel = AccumulatedMotion(256, 192)
    rng = np.random.default_rng(0)
    ways = [travel.add(rng.integers(0, 256, (192, 256), dtype=np.uint8)) for _ in range(5)]
    assert (np.diff(ways) > 0.02).all()


def test_a_blank_wall_stands_still() -> None:
    """Oracle: pictures without texture, equal but for noise, without motion."""
    travel = AccumulatedMotion(256, 192)
    rng = np.random.default_rng(0)
    flat = np.full((192, 256), 128)
    flat[60:120, 60:200] = 30
    noise = (rng.integers(-1, 2, flat.shape) for _ in range(60))
    ways = [travel.add((flat + part).astype(np.uint8)) for part in noise]
    assert ways[-1] < 0.02


def test_looking_ends_when_asked(film: Film) -> None:
    """Oracle: the number of frames at the stop request."""
    seen: list[int] = []
    with opened_video(film.path) as video, pytest.raises(Cancelled):
        survey(video, on_frame=seen.append, cancelled=lambda: len(seen) == 7)
    assert seen[-1] == 7


def test_around_a_subject_pictures_change_and_hardly_move() -> None:
    """Oracle: the angle of a cylinder with a pattern on black, with a still outline."""
    rng = np.random.default_rng(0)
    pattern = np.kron(rng.integers(0, 255, (40, 180)), np.ones((4, 4)))
    x = (np.arange(320) - 159.5) / 60
    on = np.abs(x) < 1
    travel, ways = AccumulatedMotion(320, 240), []
    for degrees in range(91):
        picture = np.zeros((240, 320))
        column = np.degrees(np.arcsin(x[on])) * 2 + 2 * degrees
        picture[40:200, on] = pattern[:, column.astype(int) % pattern.shape[1]]
        ways.append(travel.add(picture.astype(np.uint8)))
    thirds = np.diff([ways[0], ways[30], ways[60], ways[90]])
    assert ways[-1] > 5 * 0.05  # a frame every 18 degrees at least
    assert thirds.max() < 1.5 * thirds.min()


def test_a_shake_takes_no_frames_from_the_rest() -> None:
    """Oracle: an evenly moving camera with ten blurred frames of fast motion."""
    steps, detail = np.full(200, 0.01), np.full(200, 100.0)
    steps[0], steps[90:100], detail[90:100] = 0, 2.0, 1
    looked = Survey(
        seconds=np.arange(200) / 30,
        travel=steps.cumsum(),
        fine=detail,
        coarse=np.full(200, 100.0),
        repeated=np.zeros(200, bool),
    )
    frames = choose(looked, 40).frames
    assert len(frames) >= 36 and not set(frames) & set(range(90, 100))
    assert np.diff(frames[frames < 90]).max() <= 8 and np.diff(frames[frames > 99]).max() <= 8

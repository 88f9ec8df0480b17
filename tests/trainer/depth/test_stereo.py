"""The dense start; oracles: traced scenes, runs without it, and its own option."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gscore.commands import main
from gscore.config import DataConfig, Stereo, TrainConfig
from gscore.datasets import load_dataset
from gscore.io.ply.splats import read_ply
from gscore.scene import PointCloud
from gscore.trainer.depth.stereo import StereoStart, stereo_start
from gscore.trainer.files.run_folder import RunFolder
from tests.stereo.captures import ANGLES, write_capture
from tests.stereo.scene import Scene

ON = TrainConfig(stereo=Stereo.AUTO, max_splats=4000)


def start(folder: Path, config: TrainConfig = ON, known: PointCloud | None = None):
    """The points that stereo adds to a capture."""
    dataset = load_dataset(DataConfig(source=folder))
    return stereo_start(config, dataset, dataset.scene.points if known is None else known)


def off_surfaces(points: np.ndarray) -> np.ndarray:
    """Distances of [P, 3] from the wall and the ball of the scene."""
    x, y, z = points.T
    return np.minimum(
        np.abs(6 - 0.1 * x - z), np.abs(np.hypot(np.hypot(x - 0.3, y), z - 4.6) - 0.8)
    )


def test_points_are_added_and_none_is_lost(arc: Path) -> None:
    """Oracle: the capture's points first, then a fifth of `max_splats`, on surfaces."""
    dataset = load_dataset(DataConfig(source=arc))
    found = start(arc)
    assert found.points is not None and 0 < found.added <= 800
    known = dataset.scene.points
    np.testing.assert_array_equal(found.points.points[: len(known)], known.points)
    assert len(found.points) == len(known) + found.added
    assert np.quantile(off_surfaces(found.points.points[len(known) :]), 0.95) < 0.06
    assert f"{found.added:,} stereo points" in found.decision.text
    assert found.known is not None and 0.1 < found.known < 0.9


def test_the_option_says_how_many(arc: Path) -> None:
    """Oracle: the requested number."""
    found = start(arc, TrainConfig(stereo=Stereo.ON, stereo_points=300, max_splats=4000))
    assert 200 < found.added <= 300


@pytest.mark.parametrize("config", [
    TrainConfig(stereo=Stereo.OFF), TrainConfig(stereo=Stereo.ON, start_splats=Path("x.ply")),
])  # fmt: skip
def test_no_stereo_points_unless_requested(config: TrainConfig, arc: Path) -> None:
    """Oracle: no points and no sentence."""
    found = start(arc, config)
    assert found.points is None and found.known is None and found.decision is None


def without_points(folder: Path) -> Path:
    """A capture in `folder` of an arc of views with axes that meet at the subject."""
    scene = Scene(80, 60)
    write_capture(folder, scene, [scene.viewmat(angle) for angle in ANGLES], points=0)
    return folder


@pytest.mark.parametrize("stereo", [Stereo.MISSING, Stereo.AUTO, Stereo.ON])
def test_made_up_points_make_room(stereo: Stereo, tmp_path: Path) -> None:
    """Oracle: the surfaces of the scene; no random point is left, although they fill the cap."""
    config = TrainConfig(stereo=stereo, max_splats=4000)
    found = start(without_points(tmp_path), config)
    assert found.points is not None and not found.points.made_up
    assert len(found.points) == found.added > 100
    assert np.quantile(off_surfaces(found.points.points), 0.95) < 0.08
    assert found.decision.text.endswith("are the start points.")


def test_points_that_are_there_are_enough_where_only_missing_ones_are_asked_for(arc: Path) -> None:
    """Oracle: the text of the option, and of its default."""
    found = start(arc, TrainConfig(max_splats=4000))
    assert found == StereoStart()


def test_chance_agreement_adds_no_points(
    arc: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: a share above that on which these photos agree; no harm next to existing points."""
    monkeypatch.setattr("gscore.trainer.depth.stereo._CHANCE", 0.95)
    found = start(without_points(tmp_path), TrainConfig(max_splats=4000))
    assert found.points is None and found.known is not None and found.known > 0.1
    assert "almost no pixels" in found.decision.text
    assert start(arc).added > 100


def test_unused_number_of_stereo_points_warns(arc: Path) -> None:
    """Oracle: the text of the option: such points are searched where the capture has none."""
    found = start(arc, TrainConfig(stereo_points=500, max_splats=4000))
    assert found.points is None and "`--stereo on` adds more" in found.decision.text


def test_random_points_stay_where_photos_agree_on_nothing(tmp_path: Path) -> None:
    """Oracle: two photos, neither of which two others can confirm."""
    scene = Scene(80, 60)
    write_capture(tmp_path, scene, [scene.viewmat(angle) for angle in ANGLES[:2]], points=0)
    found = start(tmp_path, TrainConfig(max_splats=4000))
    assert found.points is None and "at least 3 photos" in found.decision.text


def test_reason_for_no_stereo_points(arc: Path, tmp_path: Path) -> None:
    """Oracle: as many points as the cap of splats; two photos."""
    many = PointCloud(points=np.zeros((4000, 3)), colors=np.zeros((4000, 3), np.uint8))
    full = start(arc, known=many)
    assert "leave no room" in full.decision.text and full.known is None
    half = PointCloud(points=many.points[:2100], colors=many.colors[:2100])
    assert "leave no room" in start(arc, known=half).decision.text
    asked = start(arc, replace(ON, stereo=Stereo.ON), known=half)
    assert 0 < asked.added <= 800
    scene = Scene(80, 60)
    write_capture(tmp_path, scene, [scene.viewmat(angle) for angle in ANGLES[:2]])
    found = start(tmp_path)
    assert found.points is None and "at least 3 photos" in found.decision.text and found.known == 0


LINE = ["--max-splats", "900", "--stereo", "auto", "--seed", "3", "--quiet"]


def test_a_training_starts_from_them_and_goes_on_bit_equal(
    arc: Path,
    tmp_path: Path,
) -> None:
    """Oracle: an uninterrupted run; a run without stereo, which has fewer splats."""
    whole, halves, without = (tmp_path / name for name in ("whole", "halves", "without"))
    steps = ["--iterations", "40"]
    assert main(["train", str(arc), "-o", str(whole), *steps, *LINE]) == 0
    line = ["train", str(arc), "-o", str(halves), *LINE, "--iterations", "40"]
    assert main([*line[:-1], "40", "--checkpoint-iterations", "20"]) == 0
    first = RunFolder(halves).checkpoint(20)
    again = tmp_path / "again"
    more = ["--start-checkpoint", str(first), *steps, *LINE]
    assert main(["train", str(arc), "-o", str(again), *more]) == 0
    a, b = (read_ply(folder / "point_cloud.ply") for folder in (whole, again))
    assert a.means.tobytes() == b.means.tobytes() and a.sh0.tobytes() == b.sh0.tobytes()
    line = ["train", str(arc), "-o", str(without), *LINE[:2], "--stereo", "off", "--quiet"]
    assert main([*line, "--iterations", "1"]) == 0
    plain = read_ply(without / "point_cloud.ply")
    assert len(plain) == len(load_dataset(DataConfig(source=arc)).scene.points) < len(a)


def test_splats_are_left_out_where_photos_agree_on_little(
    arc: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracles: runs with that share for any photos, and with none; the sentence; the same after a
    resume."""

    def run(name: str, *options: str) -> bytes:
        line = ["train", str(arc), "-o", str(tmp_path / name), *LINE[:-1], "--iterations", "30"]
        assert main([*line, "--checkpoint-iterations", "15", *options]) == 0
        return read_ply(tmp_path / name / "point_cloud.ply").means.tobytes()

    always, never = run("always", "--drop-rate", "0.5"), run("never", "--drop-rate", "0")
    capsys.readouterr()
    below = run("below", "--drop-rate", "0.5", "--drop-below", "0.99")
    captured = capsys.readouterr()
    assert "Photos agree on the depth of" in captured.out + captured.err
    above = run("above", "--drop-rate", "0.5", "--drop-below", "0.01")
    captured = capsys.readouterr()
    assert "Photos agree on the depth of" not in captured.out + captured.err
    assert below == always != never == above
    (last,) = (tmp_path / "below/checkpoints").glob("*30*")
    last.unlink()
    assert main(["train", "-o", str(tmp_path / "below"), "--resume"]) == 0
    assert read_ply(tmp_path / "below/point_cloud.ply").means.tobytes() == below


def test_resumed_run_keeps_its_stereo_points(tmp_path: Path) -> None:
    """Oracle: an uninterrupted run with photos that agree on no point; the resumed run reports the
    same without another search."""
    scene = Scene(80, 60)
    write_capture(tmp_path / "two", scene, [scene.viewmat(angle) for angle in ANGLES[:2]])
    line = ["train", str(tmp_path / "two"), *LINE[:2], "--stereo", "auto"]
    line += ["--iterations", "30", "--drop-rate", "0.5", "--drop-below", "0.3"]
    whole, again = tmp_path / "whole", tmp_path / "again"
    assert main([*line, "-o", str(whole), "--checkpoint-iterations", "15"]) == 0
    first = RunFolder(whole).checkpoint(15)
    assert main([*line, "-o", str(again), "--start-checkpoint", str(first)]) == 0
    decided = [json.loads((run / "metrics.json").read_text())["decided"] for run in (whole, again)]
    assert decided[0] == decided[1]
    assert any("agree on the depth of 0% of their pixels" in words for words in decided[0])
    a, b = (read_ply(folder / "point_cloud.ply").means.tobytes() for folder in (whole, again))
    assert a == b
    assert main([*line, "-o", str(tmp_path / "none"), "--drop-rate", "0"]) == 0
    assert read_ply(tmp_path / "none/point_cloud.ply").means.tobytes() != a


def test_a_checkpoint_of_a_run_without_goes_on_without(
    arc: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Oracle: a comparison of photos only where the earlier steps began so."""
    out = tmp_path / "out"
    line = ["train", str(arc), "-o", str(out), *LINE[:2], "--iterations", "10"]
    assert main([*line, "--stereo", "off", "--quiet"]) == 0
    config = out / "config.json"
    text = config.read_text()
    assert '"stereo": "off"' in text
    resumed = ["train", "-o", str(out), "--resume", "--iterations", "12"]
    assert main(resumed) == 0
    assert "surfaces" not in capsys.readouterr().out


def test_the_sentence_reaches_the_user(
    arc: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Oracle: the number of points added; where none can be, the reason, as a warning if
    requested."""
    line = ["--iterations", "2", "--max-splats", "900", "--stereo", "auto"]
    assert main(["train", str(arc), "-o", str(tmp_path / "a"), *line]) == 0
    captured = capsys.readouterr()
    assert "stereo points were added" in captured.out + captured.err
    scene = Scene(80, 60)
    write_capture(tmp_path / "two", scene, [scene.viewmat(angle) for angle in ANGLES[:2]])
    assert main(["train", str(tmp_path / "two"), "-o", str(tmp_path / "b"), *line]) == 0
    captured = capsys.readouterr()
    assert "No points were added by stereo" in captured.out + captured.err
    assert "Warning: No points" not in captured.out + captured.err
    line[-1] = "on"
    assert main(["train", str(tmp_path / "two"), "-o", str(tmp_path / "c"), *line]) == 0
    captured = capsys.readouterr()
    assert "Warning: No points were added by stereo" in captured.out + captured.err

"""`gscore depth --method stereo`; oracle: traced scenes, with the maps as a training reads them."""

import json
from pathlib import Path

import numpy as np
import pytest

from gscore.commands import main
from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.depth import Priors, load_priors
from gscore.io.images.png import write_png

from .captures import ANGLES, write_capture
from .scene import Scene

SCENE = Scene(160, 120)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A writable capture of seven photos."""
    write_capture(tmp_path, SCENE, [SCENE.viewmat(angle) for angle in ANGLES])
    return tmp_path


def priors_of(folder: Path, **options: object) -> Priors:
    """The priors of a training from the maps."""
    data = DataConfig(source=folder, depths="depths", **options)  # pyright: ignore
    return load_priors(data, load_dataset(data))


def test_maps_come_back_at_the_scale_of_the_capture(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the traced inverse depth of each pixel that counts."""
    assert main(["depth", str(own), "--method", "stereo", "--json", "--quiet"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["views"], facts["predicted"], facts["accepted"]) == (7, 7, 7)
    assert facts["align"] == "stereo" and facts["warnings"] == []
    priors = priors_of(own)
    assert priors.warnings == ()
    for index, prior in enumerate(priors.views):
        assert prior is not None and prior.aligned
        _, truth = SCENE.shot(SCENE.viewmat(ANGLES[index]))
        sure = prior.confidence > 0.3
        assert sure.mean() > 0.15
        assert np.quantile(np.abs(prior.inverse_depth / truth - 1)[sure], 0.98) < 0.02


def test_confidence_is_what_stereo_found(own: Path) -> None:
    """Oracle: lower confidence of unknown and unsure pixels than of sure ones; no surface edges at
    the border of known depth."""
    assert main(["depth", str(own), "--method", "stereo", "--quiet"]) == 0
    known = [p for p in priors_of(own).views if p is not None]
    counted = np.mean([(p.confidence > 0).mean() for p in known])
    (own / "sparse" / "0" / "depth_params.json").rename(own / "depth_params.json")
    for path in (own / "depths").glob("*.confidence.png"):
        path.unlink()
    (own / "depth_params.json").rename(own / "sparse" / "0" / "depth_params.json")
    guessed = np.mean([(p.confidence > 0).mean() for p in priors_of(own).views if p is not None])
    assert counted > 1.1 * guessed > 0


def test_held_out_photos_get_no_maps_and_no_say(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: the same files where the held-out photos are black."""

    def files() -> dict[str, bytes]:
        folder = own / "depths"
        return {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "contact_sheet.png"}

    line = ["depth", str(own), "--method", "stereo", "--hold-out", "3", "--quiet"]
    assert main(line) == 0
    before = files()
    assert "v01.png" in before and not {"v00.png", "v03.png", "v06.png"} & before.keys()
    for name in ("v00", "v03", "v06"):
        write_png(own / "images" / f"{name}.png", np.zeros((120, 160, 3), np.uint8))
    assert main(line) == 0
    assert files() == before
    capsys.readouterr()


def test_maps_made_with_held_out_photos_are_reported(own: Path) -> None:
    """Oracle: maps of all views, then of those that a training does not hold out, without any of
    the former."""
    assert main(["depth", str(own), "--method", "stereo", "--quiet"]) == 0
    split = {"eval": True, "test_every": 3}
    (sentence,) = priors_of(own, **split).warnings
    assert "3 held-out photos" in sentence and "v00.png" in sentence
    assert main(["depth", str(own), "--method", "stereo", "--hold-out", "3", "--quiet"]) == 0
    assert not (own / "depths" / "v00.png").exists()
    assert not (own / "depths" / "v00.confidence.png").exists()
    assert not any("held-out" in text for text in priors_of(own, **split).warnings)


def test_maps_of_bent_photos_are_bent(tmp_path: Path) -> None:
    """Oracle: the stereo result, after undistorting the map again."""
    from gscore.stereo import stereo_maps

    write_capture(tmp_path, SCENE, [SCENE.viewmat(angle) for angle in ANGLES], radial=-0.08)
    assert main(["depth", str(tmp_path), "--method", "stereo", "--quiet"]) == 0
    data = DataConfig(source=tmp_path)
    dataset = load_dataset(data)
    found = stereo_maps(dataset, dataset.train)
    for index, prior in enumerate(priors_of(tmp_path).views):
        assert prior is not None
        wanted = found.maps[index].inverse_depth
        both = (prior.confidence > 0) & (wanted > 0)
        assert both.mean() > 0.6 * (wanted > 0).mean()
        off = np.abs(prior.inverse_depth / np.where(both, wanted, 1) - 1)[both]
        assert np.quantile(off, 0.9) < 0.01


def test_maps_of_others_stay(own: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: the bytes of an existing map; exit code 2 and a remedy."""
    other = own / "depths" / "v00.png"
    write_png(other, np.full((120, 160), 9, np.uint16))
    before = other.read_bytes()
    assert main(["depth", str(own), "--method", "stereo"]) == 2
    assert "not made by stereo" in capsys.readouterr().err
    assert other.read_bytes() == before
    assert main(["depth", str(own), "--method", "stereo", "--overwrite", "--quiet"]) == 0
    assert other.read_bytes() != before


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("--method stereo --model x.onnx", "--model exclude each other"),
        ("--method stereo --check", "--check exclude each other"),
        ("--method stereo --align official", "official exclude each other"),
        ("--method network", "needs a network"),
    ],
)
def test_options_of_other_methods_are_refused(
    line: str, words: str, arc: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: exit code 2 and the sentence; no files."""
    assert main(["depth", str(arc), *line.split()]) == 2
    assert words in " ".join(capsys.readouterr().err.split())
    assert not (arc / "depths").exists()


def test_a_capture_without_depth_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Oracle: two photos; exit code 2, a sentence, and no folder."""
    write_capture(tmp_path, SCENE, [SCENE.viewmat(angle) for angle in ANGLES[:2]])
    assert main(["depth", str(tmp_path), "--method", "stereo"]) == 2
    assert "at least 3 photos" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "depths").exists()


def test_damaged_record_is_refused(own: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Oracle: exit code 2 and the file's name, for `gscore depth` and for a training."""
    assert main(["depth", str(own), "--method", "stereo", "--quiet"]) == 0
    (own / "depths" / "stereo.json").write_text("{")
    assert main(["depth", str(own), "--method", "stereo"]) == 2
    assert "stereo.json is damaged" in " ".join(capsys.readouterr().err.split())

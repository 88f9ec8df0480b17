"""What an engine cannot compute is refused by name; oracle: the sentence, or the absence of one."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gscore.config import Skip, Strategy, TrainConfig
from gscore.engine.base import EngineInfo, TermKind
from gscore.engine.cpu.engine import CpuEngine
from gscore.errors import ConfigError
from gscore.stress.capture import ToyPhotos
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.depth.targets import DepthTargets
from gscore.trainer.step.step_requests import LossTerms, check_engine
from gscore.trainer.trainer import Trainer
from gscore.trainer.views.photo_gains import PhotoGains
from gscore.trainer.views.photo_poses import PoseCheck
from tests.engine.fake_engine import FakeEngine
from tests.trainer.short_run import CONFIG


def terms_of(
    config: TrainConfig, photos: ToyPhotos, *, depth: DepthTargets | None = None
) -> LossTerms:
    analysis = Analysis(photos=replace(photos, mask_mode="composite"), depth=depth)
    return LossTerms(config, analysis, opaque_weight=0.0, scale=1.0)


class _Targets:
    """Stands for depth targets, which are not read."""

    unit = views = 1.0


NONE = {"features": frozenset()}
LACKS: list[tuple[dict[str, Any], dict[str, Any], dict[str, Any], str]] = [
    ({"terms": frozenset({TermKind.L1, TermKind.SSIM})}, {}, {}, "the loss term mask alpha"),
    (NONE, {}, {"depth": _Targets()}, "losses of depth maps and guide meshes"),
    (NONE, {}, {"frozen": True}, r"frozen splats around a region \(`--region`\)"),
    (NONE, {"detect_anomaly": True}, {}, r"`--detect-anomaly`"),
    (NONE, {}, {"mask_mode": "ignore"}, "masks"),
    (NONE, {}, {"drops": True}, "dropout of splats"),
    (NONE, {"strategy": Strategy.MCMC}, {}, r"`--strategy mcmc`"),
    (NONE, {}, {"gains": True}, "exposure gains"),
    (NONE, {}, {"poses": True}, "refined camera poses"),
    (NONE, {"surface_weight": 1.0}, {}, r"`--surface-weight`"),
    (NONE, {"prune_share": 0.2}, {}, "pruning by contribution"),
    (NONE, {"photo_blur": True}, {}, r"blur of photos \(`--no-photo-blur`\)"),
    (NONE, {"transient_masks": True}, {}, r"masks \(`--mask-mode none`, `--no-transient-masks`\)"),
    ({"skips": frozenset()}, {"without": (Skip.ZERO_TILE,)}, {}, "skip zero-tile"),
]


@pytest.mark.parametrize(("lack", "options", "parts", "words"), LACKS)
def test_what_an_engine_lacks_is_refused_by_name(
    photos: ToyPhotos,
    lack: dict[str, Any],
    options: dict[str, Any],
    parts: dict[str, Any],
    words: str,
) -> None:
    """Oracle: the sentence; an engine that has it is accepted, and so are trainings without."""
    whole = FakeEngine().info
    less: EngineInfo = replace(whole, **lack)
    base = replace(CONFIG, photo_blur=False, transient_masks=False)
    config, plain = replace(base, **({"alpha_weight": 0.1} | options)), base
    terms = terms_of(config, photos, depth=parts.get("depth"))
    which = {name: parts.get(name, False) for name in ("drops", "frozen")}
    empty = Analysis(photos=photos)
    analysis = Analysis(
        photos=replace(photos, mask_mode=parts.get("mask_mode", "none")),
        gains=PhotoGains([0], np.zeros((1, 3))) if "gains" in parts else None,
        pose_check=PoseCheck(viewmats=np.zeros((8, 4, 4)) if "poses" in parts else None),
    )
    with pytest.raises(ConfigError, match=f"The device fake cannot compute .*{words}"):
        check_engine(less, config, analysis, terms, **which)
    check_engine(whole, config, analysis, terms, **which)
    check_engine(less, plain, empty, terms_of(plain, photos), drops=False, frozen=False)


def test_a_trainer_asks_its_engine(photos: ToyPhotos) -> None:
    """Oracle: the error before any model is created."""
    engine = FakeEngine()
    engine.info = replace(engine.info, features=frozenset())
    with pytest.raises(ConfigError, match="--detect-anomaly"):
        Trainer(replace(CONFIG, detect_anomaly=True), Analysis(photos=photos), engine)
    assert not engine.requests


def test_the_cpu_computes_everything(photos: ToyPhotos) -> None:
    """Oracle: its info, with every skip and term; the library's instruction set."""
    info = CpuEngine(threads=3).info
    config = replace(CONFIG, detect_anomaly=True, without=tuple(Skip))
    terms = terms_of(config, photos)
    check_engine(info, config, Analysis(photos=photos), terms, drops=True, frozen=True)
    assert info.threads == 3 and info.terms == frozenset(TermKind)
    assert CpuEngine().pace() > 0

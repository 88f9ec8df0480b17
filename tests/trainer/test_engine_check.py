"""What an engine cannot compute is refused by name; oracle: the sentence, or the absence of one."""

from dataclasses import replace
from typing import Any

import pytest

from gscore.config import Skip, TrainConfig
from gscore.engine.base import EngineInfo, TermKind
from gscore.engine.cpu.engine import CpuEngine
from gscore.errors import ConfigError
from gscore.stress.capture import ToyPhotos
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.depth.targets import DepthTargets
from gscore.trainer.step.engine_check import check_engine
from gscore.trainer.step.loss_terms import LossTerms
from gscore.trainer.trainer import Trainer
from tests.engine.fake_engine import FakeEngine
from tests.trainer.short_run import CONFIG


def terms_of(config: TrainConfig, *, depth: DepthTargets | None = None) -> LossTerms:
    return LossTerms(config, mask_mode="composite", depth=depth, surface=None, scale=1.0)


class _Targets:
    """Stands for depth targets, which are not read."""

    unit = views = 1.0


LACKS: list[tuple[dict[str, Any], dict[str, Any], dict[str, Any], str]] = [
    ({"terms": frozenset({TermKind.L1, TermKind.SSIM})}, {}, {}, "the loss term mask alpha"),
    ({"picture_terms": False}, {}, {"depth": _Targets()}, "losses of depth maps and guide meshes"),
    ({"frozen": False}, {}, {"frozen": True}, r"frozen splats around a region \(`--region`\)"),
    (
        {"finds_anomalies": False},
        {"detect_anomaly": True},
        {},
        r"`--detect-anomaly`",
    ),
    ({"skips": frozenset()}, {"without": (Skip.ZERO_TILE,)}, {}, "skip zero-tile"),
]


@pytest.mark.parametrize(("lack", "options", "parts", "words"), LACKS)
def test_what_an_engine_lacks_is_refused_by_name(
    lack: dict[str, Any], options: dict[str, Any], parts: dict[str, Any], words: str
) -> None:
    """Oracle: the sentence; an engine that has it is accepted, and so are trainings without."""
    whole = FakeEngine().info
    less: EngineInfo = replace(whole, **lack)
    config = replace(CONFIG, alpha_weight=0.1, **options)
    plain = replace(CONFIG, alpha_weight=0.0)
    terms = terms_of(config, depth=parts.get("depth"))
    frozen = parts.get("frozen", False)
    with pytest.raises(ConfigError, match=f"The engine fake cannot compute .*{words}"):
        check_engine(less, config, terms, frozen=frozen)
    check_engine(whole, config, terms, frozen=frozen)
    check_engine(less, plain, terms_of(plain), frozen=False)


def test_a_trainer_asks_its_engine(photos: ToyPhotos) -> None:
    """Oracle: the error before any model is created."""
    engine = FakeEngine()
    engine.info = replace(engine.info, finds_anomalies=False)
    with pytest.raises(ConfigError, match="--detect-anomaly"):
        Trainer(replace(CONFIG, detect_anomaly=True), Analysis(photos=photos), engine)
    assert not engine.requests


def test_the_cpu_computes_everything() -> None:
    """Oracle: its info, with every skip and term; the library's instruction set."""
    info = CpuEngine(threads=3).info
    config = replace(CONFIG, detect_anomaly=True, without=tuple(Skip))
    check_engine(info, config, terms_of(config), frozen=True)
    assert info.threads == 3 and info.terms == frozenset(TermKind)
    assert CpuEngine().pace() > 0

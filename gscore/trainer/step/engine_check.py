"""Engine check: whether an engine can compute what a training needs."""

from collections.abc import Iterator

from ...config import TrainConfig
from ...engine.base import ENGINE_SKIPS, EngineInfo
from ...errors import ConfigError
from .loss_terms import LossTerms


def check_engine(info: EngineInfo, config: TrainConfig, terms: LossTerms, *, frozen: bool) -> None:
    """Raise ConfigError, with the options, for what the engine cannot compute.

    Args:
        info: The engine.
        config: The options.
        terms: Loss terms of the training.
        frozen: Whether splats around a region are frozen.
    """
    missing = list(_missing(info, config, terms, frozen=frozen))
    if missing:
        raise ConfigError(
            f"The engine {info.name} cannot compute {', '.join(missing)}. Train without, or on "
            "the CPU."
        )


def _missing(
    info: EngineInfo, config: TrainConfig, terms: LossTerms, *, frozen: bool
) -> Iterator[str]:
    needed = [kind for kind, weight in terms.terms if weight and kind not in info.terms]
    yield from (f"the loss term {kind.name.lower().replace('_', ' ')}" for kind in needed)
    if terms.needs_pictures and not info.picture_terms:
        yield "losses of depth maps and guide meshes (`--depths`, `--guide-surface`)"
    if frozen and not info.frozen:
        yield "frozen splats around a region (`--region`)"
    if config.detect_anomaly and not info.finds_anomalies:
        yield "the search for the first number that is not finite (`--detect-anomaly`)"
    skips = sorted(ENGINE_SKIPS.intersection(config.without) - info.skips)
    yield from (f"steps without the skip {skip} (`--without {skip}`)" for skip in skips)

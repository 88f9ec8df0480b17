"""Options that an engine lacks, whatever the capture."""

from collections.abc import Set

from ...config import Skip, Strategy, TrainConfig
from ...engine.base import ENGINE_SKIPS, EngineInfo, Feature
from ...errors import ConfigError


def lacking_options(config: TrainConfig, features: Set[Feature], skips: Set[Skip]) -> list[str]:
    """Return what options need of an engine that has it not, for a sentence.

    Args:
        config: The options.
        features: Features of the engine.
        skips: Skips that it can disable.
    """
    needed = {
        Feature.ANOMALIES: config.detect_anomaly,
        Feature.NOISE: config.strategy is Strategy.MCMC,
        Feature.SURFACE: config.surface_weight > 0,
        Feature.CONTRIBUTIONS: config.prune_share > 0,
    }
    without = sorted(ENGINE_SKIPS.intersection(config.without) - skips)
    return [
        *(str(one) for one, is_used in needed.items() if is_used and one not in features),
        *(f"steps without the skip {skip} (`--without {skip}`)" for skip in without),
    ]


def refuse(info: EngineInfo, lacking: list[str]) -> None:
    """Raise ConfigError if the engine lacks anything."""
    if lacking:
        raise ConfigError(
            f"The device {info.name} cannot compute {', '.join(lacking)}. Train without, or with "
            "`--device cpu`."
        )

"""What the tests of metrics.json make their reports of."""

from tests.metrics.conftest import fake_dataset, metrics_dict, wave_pair  # noqa: F401

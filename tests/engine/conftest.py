"""Fixtures of the engine tests: those of the trainer."""

from tests.marked_model import marked_model  # noqa: F401
from tests.trainer.conftest import capture, known_splats, one_torch_thread, photos  # noqa: F401

"""The small capture and run of the commands' tests, and a browser."""

import pytest

from tests.commands.conftest import *  # noqa: F403
from tests.page.chromium import Chromium, find_chromium


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """A headless Chromium that draws with software GL."""
    program = find_chromium()
    if program is None:
        pytest.skip("no Chromium here; Debian has it as the package chromium")
    with Chromium(program, tmp_path_factory.mktemp("profile")) as chromium:
        yield chromium

"""Every test that asks for `isa` runs once for each instruction set that this machine has."""

from collections.abc import Iterator

import pytest

from gscore.raster import backend


@pytest.fixture(params=backend.available_isas())
def isa(request: pytest.FixtureRequest) -> Iterator[str]:
    """The instruction set in use."""
    before = backend.isa()
    backend.set_isa(request.param)
    yield request.param
    backend.set_isa(before)

"""Every test that asks for `isa` runs once for each instruction set that this machine has."""

from collections.abc import Iterator

import pytest

from gscore.raster import native_library


@pytest.fixture(params=native_library.available_isas())
def isa(request: pytest.FixtureRequest) -> Iterator[str]:
    """The instruction set in use."""
    before = native_library.isa()
    native_library.set_isa(request.param)
    yield request.param
    native_library.set_isa(before)

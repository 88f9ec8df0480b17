"""Errors for users. Each message has the problem, the place, the expected value and a remedy."""


class GsError(Exception):
    """Base of every error gscore raises on purpose."""


class DatasetError(GsError):
    """A capture is unusable: missing files, mismatched names, no training data."""


class FormatError(GsError):
    """A file is truncated, corrupt or of another format than its name."""


class ConfigError(GsError, ValueError):
    """An option has an invalid value."""


class ShapeError(GsError, ValueError):
    """An array has the wrong shape, dtype, layout or device."""


class BackendError(GsError, RuntimeError):
    """The native library or an optional package is missing or failed."""

    def __init__(self, message: str = "", *, package: str = "", install: str = "") -> None:
        super().__init__(message)
        self.package = package
        """The optional package that is missing; empty: none."""
        self.install = install
        """The command that installs it."""


class Cancelled(GsError):  # noqa: N818 - nothing went wrong
    """The caller requested cancellation."""

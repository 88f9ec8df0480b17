"""Errors for users. Each message has the problem, the place, the expected value and a remedy."""


class GsError(Exception):
    """Base of every error gscore raises on purpose."""


class DatasetError(GsError):
    """A capture cannot be used: files missing, names that do not match, nothing to train on."""


class FormatError(GsError):
    """A file is not what its name says: truncated, corrupt or of another kind."""


class ConfigError(GsError, ValueError):
    """An option has a value that cannot work."""


class ShapeError(GsError, ValueError):
    """An array has the wrong shape, dtype, layout or device."""


class BackendError(GsError, RuntimeError):
    """The native library or an optional package is missing or failed."""


class Cancelled(GsError):  # noqa: N818 - nothing went wrong
    """The caller asked to stop."""

"""Sizes and durations as people write them."""


def size_words(count: int | None) -> str:
    """Bytes in decimal units: 12.3 MB."""
    if count is None:
        return "n/a"
    for factor, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if count >= factor:
            return f"{count / factor:.3g} {unit}"
    return f"{count} B"


def time_words(seconds: float | None) -> str:
    """A duration: 42 s, 3 min 05 s, 1 h 02 min."""
    if seconds is None:
        return "n/a"
    if seconds < 60:
        return f"{seconds:.3g} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"

"""Warning log: collects logged warnings, for callers that display them."""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """Context that collects the warnings gscore logs on this thread.

    Other handlers still receive them.
    """
    collected: list[str] = []
    thread = threading.get_ident()

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.thread == thread:
                collected.append(record.getMessage())

    logger, keep = logging.getLogger(__name__.rpartition(".")[0]), Keep(level=logging.WARNING)
    logger.addHandler(keep)
    try:
        yield collected
    finally:
        logger.removeHandler(keep)

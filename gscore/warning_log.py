"""Warning log: collects the warnings that gscore logs, for callers that show them."""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """The messages gscore logs as warnings within the block, on this thread; who calls shows them.

    They reach handlers that are there besides.
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

"""Viewer options of a training: `--port`, `--ip`, `--disable-viewer`."""

import argparse
import ipaddress
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...errors import ConfigError
from ...events import Show, Warn
from ...live.viewer_clients import ViewerClients
from ...live_options import LiveOptions
from ...quoting import quoted
from .run_options import declare


def add_live_options(group: argparse._ActionsContainer) -> None:
    """Declare them."""
    declare(group, LiveOptions)


def check_live_options(options: LiveOptions) -> None:
    """Check the address of the viewer server without opening the port.

    Raises:
        ConfigError: the address is invalid.
    """
    if options.port:
        _is_own(options.ip)


@contextmanager
def viewer_clients_of(
    options: LiveOptions, source: Path, show: Show, *, after_the_end: bool = False
) -> Iterator[ViewerClients | None]:
    """Context of the viewer clients of a training; None without a port.

    Args:
        options: Port and address.
        source: The capture, whose path viewers receive.
        show: Receives a warning if other computers can connect.
        after_the_end: Keep serving viewers after the last step.

    Raises:
        ConfigError: the port or the address cannot be used.
    """
    if not options.port:
        yield None
        return
    from ...live.server import Server

    with Server(options, text=str(source.resolve()), after_the_end=after_the_end) as server:
        if not _is_own(options.ip):
            message = f"Any computer that reaches {options.ip} can watch and pause this training."
            show(Warn(message=message, code="viewer"))
        yield server.viewers


def _is_own(ip: str) -> bool:
    """Whether only this computer reaches an address."""
    try:
        return ipaddress.ip_address(ip.partition("%")[0]).is_loopback
    except ValueError as error:
        raise ConfigError(f"ip must be a numeric address, got {quoted(ip)}.") from error

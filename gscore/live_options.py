"""Live viewer options; never part of a run's config, which may come from a third party."""

from dataclasses import dataclass

from .options import Range, check_options, option


@dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """Address and port of the viewer server."""

    port: int = option(
        0,
        "Port for 3DGS viewers to watch the training; their default is 6009; 0: off. See "
        "docs/view.md.",
        group="viewer",
        range=Range(high=65535),
        metavar="PORT",
        basic=True,
        when="viewer",
    )
    ip: str = option(
        "127.0.0.1",
        "Address that viewers connect to. The default accepts this computer only; 0.0.0.0 accepts "
        "every computer that reaches this one.",
        group="viewer",
        metavar="ADDRESS",
        when="port",
    )

    def __post_init__(self) -> None:
        check_options(self)

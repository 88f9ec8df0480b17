"""Live viewer options; never part of a run's config, which may come from a third party."""

from dataclasses import dataclass

from .options import Range, check_options, option


@dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """Where viewers may connect to."""

    port: int = option(
        0,
        "Port at which viewers of 3DGS can watch the training; theirs is 6009. 0: none can. "
        "docs/view.md says more.",
        group="watching",
        range=Range(high=65535),
        metavar="PORT",
        basic=True,
        when="viewer",
    )
    ip: str = option(
        "127.0.0.1",
        "Address that viewers connect to. The default is reached from this computer alone; 0.0.0.0 "
        "is every address it has, and whoever reaches it can watch.",
        group="watching",
        metavar="ADDRESS",
        when="port",
    )

    def __post_init__(self) -> None:
        check_options(self)

"""Depth networks by name: the chosen one, its installation, and permission to download."""

import bpy

from .. import preferences
from ..core import KnownNetwork, depth_networks
from ..trainer_python import setup
from ..training import facts, lookups

OFFLINE = (
    "Blender does not allow add-ons to go online; allow it in Preferences > System > Network, or "
    "choose an ONNX file."
)


def may_go_online() -> bool:
    """True if Blender allows add-ons to go online."""
    return bpy.app.online_access


def known(name: str) -> KnownNetwork | None:
    """The network with a name; None: unknown name."""
    return next((network for network in depth_networks() if network.name == name), None)


def chosen() -> KnownNetwork | None:
    """The named network of the preferences; None: a file is chosen."""
    return known(preferences.get().depth_network)


def is_installed(network: KnownNetwork) -> bool | None:
    """True if the network is installed; None: not known yet.

    Raises:
        ValueError: the query failed; the message gives the reason.
    """
    python = str(setup.trainer_python(preferences.get()))
    answer, problem = facts.ask(lookups.networks, python)
    if problem:
        raise ValueError(problem)
    return None if answer is None else network.name in answer


def check_download(network: KnownNetwork, download: bool) -> None:
    """Raise ValueError if a download is not allowed, or is needed and not requested."""
    if download and not may_go_online():
        raise ValueError(OFFLINE)
    if not download and is_installed(network) is False:
        raise ValueError(f"{network.name} is not on this computer; press Download and Predict.")


def terms(network: KnownNetwork) -> str:
    """Size and licence, to show before a download."""
    return f"{network.bytes / 1e6:.0f} MB, licence {network.licence}"


def confirm_lines(network: KnownNetwork) -> list[str]:
    """Sentences on a download for the confirmation dialog."""
    return [
        f"{network.name} is downloaded: {terms(network)}.",
        f"From {network.page}, weights of {network.source}.",
        "It is stored in the cache of huggingface_hub, which other programs share, and checked "
        "against its SHA-256.",
    ]

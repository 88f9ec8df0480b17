"""Hub files of the known networks: the shared hub cache, and downloads into it."""

import contextlib
import hashlib
import logging
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import BackendError, ConfigError, FormatError, GsError
from ..extras import need
from ..io.files import reason
from ..quoting import brief
from ..text_format import size_text
from .catalogue import KnownNetwork


def cached_file(network: KnownNetwork) -> Path | None:
    """Path of the file in the shared hub cache; None: it was not downloaded yet.

    Raises:
        BackendError: huggingface_hub is not installed.
    """
    hub = _hub()
    found = hub.try_to_load_from_cache(network.repository, network.file, revision=network.revision)
    return Path(found) if isinstance(found, str) else None


def network_file(network: KnownNetwork, *, download: bool) -> Path:
    """The file of a network, checked against its SHA-256.

    Args:
        network: The network.
        download: Allow a download, with the user's own hub settings (HF_HOME, HF_ENDPOINT,
            HF_TOKEN, HF_HUB_OFFLINE).

    Raises:
        BackendError: huggingface_hub is not installed.
        ConfigError: the file is not in the cache, and a download is not allowed.
        GsError: the hub cannot be reached, has no such file, or the disk is full.
        FormatError: the cached or downloaded file has another SHA-256; it was removed.
    """
    path = cached_file(network)
    if path is None and not download:
        raise ConfigError(
            f"{network.name} is not on this machine. `--download` fetches it into the cache of "
            f"huggingface_hub: {terms(network)}."
        )
    if path is None:
        path = _downloaded(network)
    _check(network, path)
    return path


def terms(network: KnownNetwork) -> str:
    """Size, licence and source of a download, for the user to decide."""
    return f"{size_text(network.bytes)}, licence {network.licence}, from {network.page}"


def _hub() -> Any:
    hub = need("huggingface_hub", "Depth networks by name")
    if not hasattr(hub, "try_to_load_from_cache"):
        raise BackendError(
            "The installed huggingface_hub is too old; update it with: "
            'pip install --upgrade "gscore[hub]"'
        )
    return hub


def _downloaded(network: KnownNetwork) -> Path:
    hub = _hub()
    try:
        with _quiet():
            found = hub.hf_hub_download(
                network.repository, network.file, revision=network.revision, library_name="gscore"
            )
    except Exception as error:  # of the hub, of its HTTP library, of the disk
        raise GsError(f"{network.name} cannot be downloaded: {_why(error, network)}") from error
    return Path(found)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Context manager without the hub's progress bars and log of retries."""
    from huggingface_hub.utils import (
        are_progress_bars_disabled,
        disable_progress_bars,
        enable_progress_bars,
    )

    log, had_bars = logging.getLogger("huggingface_hub"), not are_progress_bars_disabled()
    level = log.level
    disable_progress_bars()
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)
        if had_bars:
            enable_progress_bars()


def _why(error: Exception, network: KnownNetwork) -> str:
    """Cause and remedy, by the names of the hub's errors, because their base classes differ between
    its versions."""
    kinds = {cls.__name__ for each in _chain(error) for cls in type(each).__mro__}
    if "GatedRepoError" in kinds:
        return f"its authors require you to agree first, at {network.page}; then set HF_TOKEN."
    if kinds & {"EntryNotFoundError", "RepositoryNotFoundError", "RevisionNotFoundError"} and (
        "LocalEntryNotFoundError" not in kinds
    ):
        return (
            f"the hub has no {network.file} of {network.repository} any more. Give the path of a "
            "file with `--model`."
        )
    if os.environ.get("HF_HUB_OFFLINE", "").lower() in ("1", "true", "yes", "on"):
        return "HF_HUB_OFFLINE forbids it. Unset it, or give the path of a file with `--model`."
    for each in _chain(error):
        if isinstance(each, OSError) and each.errno and "Connect" not in type(each).__name__:
            return reason(each)
    return (
        f"the hub cannot be reached ({_cause(error)}). Check the connection, or download "
        f"{network.file} from {network.page} and give its path with `--model`."
    )


def _cause(error: Exception) -> str:
    """The root cause, without the advice in the hub's own errors."""
    messages = [str(each).strip() for each in _chain(error)]
    last = next((text for text in reversed(messages) if text), type(error).__name__)
    return brief(last.splitlines()[0].rstrip("."))


def _chain(error: BaseException | None) -> list[BaseException]:
    found: list[BaseException] = []
    while error is not None and error not in found:
        found.append(error)
        error = error.__cause__ or error.__context__
    return found


def _check(network: KnownNetwork, path: Path) -> None:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if digest == network.sha256:
        return
    # Remove both the link in the cache and its target, or the next call would find it again.
    for each in {path.resolve(), path}:
        each.unlink(missing_ok=True)
    raise FormatError(
        f"The file from the hub for {network.name} has the SHA-256 {digest[:12]}..., expected "
        f"{network.sha256[:12]}...; it was removed. Try again with `--download`, or download it in "
        "a browser and give its path with `--model`."
    )

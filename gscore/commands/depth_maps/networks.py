"""Depth networks of `gscore depth`, by name or file."""

import argparse
from pathlib import Path

from ...datasets import Dataset
from ...depth.catalogue import all_networks, known, network_names
from ...depth.hub import cached_file, network_file, terms
from ...depth.network import Network, Normalization
from ...errors import BackendError, ConfigError
from ...events import DepthProgress, Show
from ...quoting import brief
from ...text_format import size_text
from ..terminal.output import print_json


def network_path(args: argparse.Namespace, show: Show) -> tuple[Path, Normalization]:
    """The file of --model and its input normalisation."""
    entry = known(args.model)
    path = Path(args.model)
    if entry is None or path.is_file():
        if entry is None and not path.suffix:
            raise ConfigError(
                f"There is no model {brief(path)}: give an ONNX file, or one of "
                f"{', '.join(network_names())}."
            )
        return path, args.normalization
    if args.download and cached_file(entry) is None:
        phase = f"downloading {entry.name}: {terms(entry)}"
        show(DepthProgress(done=0, total=0, view="", eta_s=float("nan"), phase=phase))
    found = network_file(entry, download=args.download)
    auto = args.normalization is Normalization.AUTO
    return found, entry.normalization if auto else args.normalization


def list_models(args: argparse.Namespace) -> int:
    """Print the named networks; returns the exit code."""
    rows = []
    for network in all_networks():
        try:
            here = cached_file(network)
        except BackendError:  # without the hub's library nothing was downloaded
            here = None
        rows.append(
            {
                "name": network.name,
                "bytes": network.bytes,
                "licence": network.licence,
                "input": network.input,
                "kind": network.kind.value,
                "page": network.page,
                "source": network.source,
                "file": None if here is None else str(here),
            }
        )
    if args.json:
        print_json({"models": rows})
        return 0
    for row in rows:
        here = "on this machine" if row["file"] else f"{size_text(row['bytes'])} to download"
        print(f"{row['name']}  ({here}; licence {row['licence']}; input {row['input']})")
        print(f"    {row['page']}, weights of {row['source']}")
    return 0


def network_text(network: Network, dataset: Dataset) -> str:
    """Description of a network: detected family, input size and normalisation."""
    profile = network.profile
    width, height = network.input_size(*dataset.files[0].photo_size)
    return (
        f"{network.path.name}, detected as {profile.family}: input {width} x {height} px, "
        f"normalization {profile.normalization}"
    )

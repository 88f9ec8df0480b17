"""Catalogue of depth networks: URLs of their ONNX files, licences, input formats.

Sizes and SHA-256 are from the hub's pages and at least one other project that pins the file; an
entry with one source has a comment. Input and output formats are from the authors' code; no file
was downloaded to verify them.

Left out: MiDaS and DPT exports of unknown origin; Depth Anything V2 Large (1.3 GB); metric versions
of Depth Anything, for which no export with a stable URL was found.
"""

from dataclasses import dataclass

from .maps import DepthKind
from .network import Normalization


@dataclass(frozen=True, kw_only=True)
class KnownNetwork:
    """A network that can be downloaded by its name."""

    name: str
    repository: str
    """Repository on huggingface.co."""
    file: str
    """Path in the repository."""
    revision: str
    """Commit that pins the file."""
    bytes: int
    """Size of the file; rounded if its source is."""
    sha256: str
    licence: str
    normalization: Normalization
    kind: DepthKind
    input: str
    """Description of the input size, px."""
    source: str
    """URL of the authors' code and weights."""

    @property
    def page(self) -> str:
        """URL of the model page."""
        return f"https://huggingface.co/{self.repository}"


NETWORKS = (
    KnownNetwork(
        name="depth-anything-v2-small",
        repository="onnx-community/depth-anything-v2-small",
        file="onnx/model.onnx",
        revision="4472b7362082ad9968fee890ca0f1e5aca36b93d",
        bytes=99_100_000,
        sha256="afb6a5c28f3b6bf1618c6e43f02073ef9dfdc70e937502d51603e57b0a1df10c",
        licence="Apache-2.0",
        normalization=Normalization.IMAGENET,
        kind=DepthKind.INVERSE,
        input="518 on the shorter side",
        source="https://github.com/DepthAnything/Depth-Anything-V2",
    ),
    # One source for the SHA-256 and the exact size; the commit and the rounded size from the hub.
    KnownNetwork(
        name="depth-anything-v2-base",
        repository="onnx-community/depth-anything-v2-base",
        file="onnx/model.onnx",
        revision="70fc6025110462412a23f8f647d2cd708d6ecc2e",
        bytes=388_917_010,
        sha256="dab40f67d5ead5e0ed52acfae41a717a708b02bc57f6cb761c5de828f26a7289",
        licence="CC-BY-NC-4.0, not for commercial use",
        normalization=Normalization.IMAGENET,
        kind=DepthKind.INVERSE,
        input="518 on the shorter side",
        source="https://github.com/DepthAnything/Depth-Anything-V2",
    ),
    # The file of MiDaS' own release v2_1; its graph includes the normalization, from [0, 1].
    KnownNetwork(
        name="midas-v2.1-small",
        repository="julienkay/sentis-MiDaS",
        file="midas_v21_small_256.onnx",
        revision="b867253b86ef4cef1cfda70e8fbcf72fb27eaa3e",
        bytes=66_389_153,
        sha256="b0a5b3f12625137e626805167907fe0410665bec671685d59daaa2daab19f977",
        licence="MIT",
        normalization=Normalization.AUTO,
        kind=DepthKind.INVERSE,
        input="256 x 256",
        source="https://github.com/isl-org/MiDaS",
    ),
    # The repository states no licence of its own; the weights' is that of Intel's page.
    KnownNetwork(
        name="dpt-hybrid-midas",
        repository="Xenova/dpt-hybrid-midas",
        file="onnx/model.onnx",
        revision="c9ab952ed178a2f0c085a4602d0a9da35bc54bca",
        bytes=533_061_339,
        sha256="2eca68239006c64af94bdfa68464f34d7627c3dca7bb02932636e616c55a39ff",
        licence="Apache-2.0",
        normalization=Normalization.HALF,
        kind=DepthKind.INVERSE,
        input="384 x 384",
        source="https://huggingface.co/Intel/dpt-hybrid-midas",
    ),
)
"""Known networks, in the order of `--list-models`."""


def known(name: str) -> KnownNetwork | None:
    """The network of this name, in any case; None: unknown."""
    return next((network for network in NETWORKS if network.name == name.lower()), None)


def all_networks() -> tuple[KnownNetwork, ...]:
    """All networks, in the order of the list."""
    return NETWORKS


def network_names() -> list[str]:
    """All names."""
    return [network.name for network in NETWORKS]

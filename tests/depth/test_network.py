"""Detection and input of networks: real ONNX files that compute a known function of a photo."""

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from gscore.depth.maps import DepthKind
from gscore.depth.network import Network, Normalization
from gscore.errors import ConfigError, FormatError, GsError

MEAN, DEVIATION = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
WEIGHTS = np.array([2.0, 3.0, 5.0])
COLOR = np.array([200, 120, 40])
EXPECTED = {
    "imagenet": 20 + WEIGHTS @ ((COLOR / 255 - MEAN) / DEVIATION),
    "half": 20 + WEIGHTS @ (COLOR / 127.5 - 1),
    "unit": 20 + WEIGHTS @ (COLOR / 255),
    "bytes": 20 + WEIGHTS @ COLOR,
}
"""Outputs for a photo of one colour, by hand."""


def _flat(width=64, height=48):
    return np.broadcast_to(COLOR.astype(np.uint8), (height, width, 3)).copy()


CASES = [
    ("midas", {"size": 256}, "MiDaS 2.1 small", "imagenet", "imagenet"),
    ("midas", {"size": 384}, "MiDaS 2.1", "imagenet", "imagenet"),
    ("midas", {"inside": (MEAN, DEVIATION)}, "MiDaS 2.1 small", "unit", "imagenet"),
    ("midas", {"inside": (255 * MEAN, 255 * DEVIATION)}, "MiDaS 2.1 small", "bytes", "imagenet"),
    ("midas", {"half": True}, "MiDaS 2.1 small", "imagenet", "imagenet"),
    ("channels_last", {}, "MiDaS 2.1 small", "imagenet", "imagenet"),
    ("transformer", {"patch": 16, "shape": [1, 3, 384, 384]}, "DPT / MiDaS 3", "half", "half"),
    ("transformer", {"patch": 16, "shape": [1, 3, 512, 512]}, "DPT / MiDaS 3", "half", "half"),
    (
        "transformer",
        {"patch": 14, "shape": [1, 3, 518, 518]},
        "Depth Anything",
        "imagenet",
        "imagenet",
    ),
    (
        "transformer",
        {"patch": 14, "shape": ["batch", 3, "height", "width"]},
        "Depth Anything",
        "imagenet",
        "imagenet",
    ),
]


@pytest.mark.parametrize(("maker", "options", "family", "normalization", "formula"), CASES)
def test_families(tmp_path, networks, maker, options, family, normalization, formula):
    """Oracle: the value of the network's formula for one colour, worked out by hand."""
    path = networks[maker](tmp_path / "net.onnx", **options)
    network = Network(path, threads=1)
    assert network.profile.family == family
    assert network.profile.normalization == normalization
    assert network.profile.kind is DepthKind.INVERSE
    out = network.predict(_flat())
    assert out.shape == (48, 64) and out.dtype == np.float32
    assert out == pytest.approx(EXPECTED[formula], rel=4e-3 if options.get("half") else 1e-4)


@pytest.mark.parametrize("normalization", [n for n in Normalization if n != "auto"])
def test_normalization_can_be_overridden(tmp_path, networks, normalization):
    """Oracle: the same by hand, for each normalisation."""
    path = networks["midas"](tmp_path / "net.onnx")
    network = Network(path, normalization=normalization, threads=1)
    assert network.predict(_flat()) == pytest.approx(EXPECTED[normalization.value], rel=1e-4)


@pytest.mark.parametrize("maker", ["midas", "channels_last", "transformer"])
@pytest.mark.parametrize(("width", "height"), [(90, 60), (60, 90), (700, 500)])
def test_orientation_and_size(tmp_path, networks, maker, width, height):
    """Oracle: a brighter right and a redder lower half, at the same places in the map."""
    options = {"patch": 14, "shape": [1, 3, "h", "w"]} if maker == "transformer" else {}
    network = Network(networks[maker](tmp_path / "net.onnx", **options), threads=1)
    photo = np.full((height, width, 3), 60, np.uint8)
    photo[:, width // 2 :] += 80
    photo[height // 2 :, :, 0] += 40
    out = network.predict(photo)
    assert out.shape == (height, width)
    rows, columns = (height // 4, 3 * height // 4), (width // 4, 3 * width // 4)
    got = out[np.ix_(rows, columns)]
    expected = [
        [20 + WEIGHTS @ ((photo[r, c] / 255 - MEAN) / DEVIATION) for c in columns] for r in rows
    ]
    assert got == pytest.approx(np.array(expected), rel=2e-3)


@pytest.mark.parametrize(
    ("photo", "expected"),
    [((1920, 1080), (924, 518)), ((480, 640), (518, 686)), ((90, 90), (518,) * 2)],
)
def test_free_sizes_keep_proportions(tmp_path, networks, photo, expected):
    """Oracle: shorter side 518, both sides the nearest multiples of 14."""
    path = networks["transformer"](tmp_path / "n.onnx", patch=14, shape=[1, 3, "h", "w"])
    assert Network(path, threads=1).input_size(*photo) == expected
    half = Network(path, size=252, threads=1).input_size(*photo)
    assert min(half) == 252 and all(side % 14 == 0 for side in half)


def test_sizes_that_cannot_be(tmp_path, networks):
    """Oracle: errors with the sizes that the network accepts."""
    free = networks["transformer"](tmp_path / "free.onnx", patch=14, shape=[1, 3, "h", "w"])
    with pytest.raises(ConfigError, match="multiple of 14"):
        Network(free, size=300)
    with pytest.raises(ConfigError, match="only takes pictures of 256 x 256 pixels"):
        Network(networks["midas"](tmp_path / "fixed.onnx"), size=512)


def test_kind_from_the_graph(tmp_path, networks):
    """Oracle: a bounded output, as in metric networks, or `metric` in the name, for depth."""
    network = Network(networks["midas"](tmp_path / "a.onnx", metric=True), threads=1)
    assert network.profile.kind is DepthKind.DEPTH
    named = networks["midas"](tmp_path / "depth_anything_metric_indoor.onnx")
    assert Network(named, threads=1).profile.kind is DepthKind.DEPTH


def _quantized(path, style):
    """A patch embedding of 14 px as stored by quantizing tools."""
    scale = numpy_helper.from_array(np.array(0.1, np.float32), "scale")
    zero = numpy_helper.from_array(np.array(128, np.uint8), "zero")
    kernel = numpy_helper.from_array(np.full((4, 3, 14, 14), 130, np.uint8), "kernel")
    strides = {"strides": [14, 14]}
    if style == "dynamic":
        nodes = [
            helper.make_node("DynamicQuantizeLinear", ["image"], ["q", "s", "z"]),
            helper.make_node("ConvInteger", ["q", "kernel", "z", "zero"], ["sums"], **strides),
            helper.make_node("Cast", ["sums"], ["y"], to=TensorProto.FLOAT),
        ]
    elif style == "dequantized":
        nodes = [
            helper.make_node("DequantizeLinear", ["kernel", "scale", "zero"], ["plain"]),
            helper.make_node("Conv", ["image", "plain"], ["y"], **strides),
        ]
    else:
        quantize = ["scale", "zero"]
        nodes = [
            helper.make_node("QuantizeLinear", ["image", *quantize], ["q"]),
            helper.make_node(
                "QLinearConv", ["q", *quantize, "kernel", *quantize, *quantize], ["r"], **strides
            ),
            helper.make_node("DequantizeLinear", ["r", *quantize], ["y"]),
        ]
    graph = helper.make_graph(
        nodes,
        "net",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, 518, 518])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, 4, 37, 37])],
        [scale, zero, kernel],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, path)
    return path


@pytest.mark.parametrize("style", ["dynamic", "dequantized", "static"])
def test_quantized_networks_are_detected_by_their_kernel(tmp_path, style):
    """Oracle: the 14 px patches of Depth Anything, for any storage of the kernel."""
    network = Network(_quantized(tmp_path / "net.onnx", style), threads=1)
    assert (network.profile.family, network.profile.multiple) == ("Depth Anything", 14)


def test_missing_model(tmp_path):
    """Oracle: the error, with the file and the source of such models."""
    with pytest.raises(ConfigError, match=r"no model .*x\.onnx.*MiDaS/releases.*Depth-Anything"):
        Network(tmp_path / "x.onnx")


@pytest.mark.parametrize("content", [b"", b"not a model", b"\x08\x08\x12\x04abcd", bytes(5000)])
def test_files_that_are_no_models(tmp_path, content):
    """Oracle: a FormatError with the name of the file, for every kind of invalid file."""
    path = tmp_path / "net.onnx"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"net\.onnx"):
        Network(path)


def test_truncated_model(tmp_path, networks):
    """Oracle: a FormatError for a cut at any place."""
    path = networks["midas"](tmp_path / "net.onnx")
    whole = path.read_bytes()
    for part in (0.2, 0.5, 0.9, 0.99):
        path.write_bytes(whole[: int(part * len(whole))])
        with pytest.raises(FormatError, match=r"net\.onnx"):
            Network(path)


def _other(path, inputs, output):
    """A network of another kind: sums its first input to `output`."""
    graph = helper.make_graph(
        [helper.make_node("ReduceMean", [inputs[0][0]], ["y"], keepdims=0, axes=output[1])],
        "net",
        [helper.make_tensor_value_info(n, t, s) for n, t, s in inputs],
        [helper.make_tensor_value_info("y", inputs[0][1], output[0])],
    )
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), path
    )
    return path


FLOAT, BYTES = TensorProto.FLOAT, TensorProto.INT32


@pytest.mark.parametrize(
    ("inputs", "output", "word"),
    [
        ([("x", FLOAT, [1, 3, 8, 8]), ("z", FLOAT, [1])], ([1, 8, 8], [1]), "expected one picture"),
        ([("x", BYTES, [1, 3, 8, 8])], ([1, 8, 8], [1]), "float numbers"),
        ([("x", FLOAT, [1, 1, 8, 8])], ([1, 8, 8], [1]), "one colour picture"),
        ([("x", FLOAT, [4, 3, 8, 8])], ([4, 8, 8], [1]), "one colour picture"),
        ([("x", FLOAT, [1, 300])], ([1], [1]), "expected"),
        ([("x", FLOAT, [1, 3, 8, 8])], ([1], [1, 2, 3]), "expected a map"),
    ],
)
def test_networks_of_another_kind(tmp_path, inputs, output, word):
    """Oracle: a FormatError with the expected kind, before any photo is read."""
    with pytest.raises(FormatError, match=word):
        Network(_other(tmp_path / "net.onnx", inputs, output))


def test_a_classifier_in_disguise(tmp_path):
    """Oracle: an output that is no map, detected when it arrives."""
    path = _other(tmp_path / "net.onnx", [("x", FLOAT, [1, 3, 32, 32])], ([1, "n"], [2, 3]))
    with pytest.raises(GsError, match="one number per pixel"):
        Network(path).predict(_flat())

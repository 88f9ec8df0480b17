"""ONNX graph of a file, parsed without onnxruntime, which does not expose it."""

import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import FormatError
from ..quoting import brief

_ARITHMETIC = frozenset({"Sub", "Add", "Div", "Mul", "BatchNormalization"})
_PASSING = frozenset(
    {"Cast", "Identity", "Pad", "Transpose", "Reshape", "Squeeze", "Unsqueeze", "Resize", "Slice"}
    | {"Split", "Concat", "Gather", "QuantizeLinear", "DequantizeLinear"}
    | {"DynamicQuantizeLinear"}
)
"""Operations allowed between the input of a network and its first convolution."""
_CONVOLUTIONS = {"Conv": 1, "ConvInteger": 1, "QLinearConv": 3}
"""Convolutions, plain and quantized, and the index of their kernel among the inputs."""
_ATTENTION = frozenset(
    {"Softmax", "LayerNormalization", "Attention", "MultiHeadAttention", "Erf", "Gelu"}
)
_LARGEST_CONSTANT = 64
"""Maximum size of a constant that is read; means and deviations of colours have few numbers."""


@dataclass(frozen=True, kw_only=True)
class GraphFacts:
    """Properties of a graph that identify its family of networks."""

    kernel: tuple[int, ...] = ()
    """Sides of the first convolution's kernel; empty: not found."""
    arithmetic: tuple[str, ...] = ()
    """Arithmetic operations on the input before that convolution."""
    constants: tuple[float, ...] = ()
    """Largest magnitude in each of their constants, if stored in the file."""
    attention: bool = False
    """Whether it is a transformer."""
    last: tuple[str, ...] = ()
    """The operations before the output, the last one first."""


@dataclass(kw_only=True)
class _Node:
    op: str = ""
    inputs: list[str] = field(default_factory=list)
    outputs: list[str] = field(default_factory=list)
    constant: float | None = None


@dataclass(kw_only=True)
class _Tensor:
    name: str = ""
    dims: list[int] = field(default_factory=list)
    largest: float | None = None


def read_facts(path: Path, input_name: str, output_name: str) -> GraphFacts:
    """Read the properties; weights are skipped, so this takes milliseconds for any size.

    Raises:
        FormatError: the file is not an ONNX model.
    """
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            nodes, tensors = _graph(data)
    except (OSError, ValueError, IndexError, struct.error, UnicodeDecodeError) as error:
        raise FormatError(
            f"{path} is not an ONNX model: {brief(error)}. Download it again."
        ) from error
    constants = {name: t.largest for name, t in tensors.items()}
    constants |= {o: n.constant for n in nodes if n.op == "Constant" for o in n.outputs}
    consumers: dict[str, list[_Node]] = {}
    for node in nodes:
        for name in node.inputs:
            consumers.setdefault(name, []).append(node)
    kernel: tuple[int, ...] = ()
    arithmetic, sizes = [], []
    waiting, met = [input_name], {input_name}
    while waiting and not kernel:
        for node in consumers.get(waiting.pop(0), []):
            if node.op in _CONVOLUTIONS:
                kernel = _kernel(node, nodes, tensors)
                break
            if node.op in _ARITHMETIC:
                arithmetic.append(node.op)
                sizes += [c for name in node.inputs if (c := constants.get(name)) is not None]
            if node.op in _ARITHMETIC | _PASSING:
                waiting += [name for name in node.outputs if name not in met]
                met.update(node.outputs)
    return GraphFacts(
        kernel=kernel,
        arithmetic=tuple(arithmetic),
        constants=tuple(sizes),
        attention=any(node.op in _ATTENTION for node in nodes),
        last=_last(nodes, output_name),
    )


def _kernel(conv: _Node, nodes: list[_Node], tensors: dict[str, _Tensor]) -> tuple[int, ...]:
    """Sides of a convolution's kernel, which may be stored quantized; empty: unknown."""
    name = next(iter(conv.inputs[_CONVOLUTIONS[conv.op] :]), "")
    for node in nodes:
        if node.op in ("DequantizeLinear", "Cast", "Identity") and name in node.outputs:
            name = node.inputs[0]
            break
    return tuple(tensors[name].dims[2:]) if name in tensors else ()


def _last(nodes: list[_Node], name: str) -> tuple[str, ...]:
    """Names of the operations from the output backwards, at most six."""
    makers = {output: node for node in nodes for output in node.outputs}
    found = []
    while name in makers and len(found) < 6:
        node = makers[name]
        found.append(node.op)
        made = [i for i in node.inputs if i in makers and makers[i].op != "Constant"]
        if not made:
            break
        name = made[0]
    return tuple(found)


# Protocol Buffers' wire format: a key (field number * 8 + wire type), then a value. Numbers of
# the fields are those of onnx.proto.


def _graph(data: mmap.mmap) -> tuple[list[_Node], dict[str, _Tensor]]:
    nodes: list[_Node] = []
    tensors: dict[str, _Tensor] = {}
    for number, value in _fields(data, 0, len(data)):
        if number != 7 or not isinstance(value, tuple):
            continue
        for inner, part in _fields(data, *value):
            if inner == 1 and isinstance(part, tuple):
                nodes.append(_node(data, *part))
            elif inner == 5 and isinstance(part, tuple):
                tensor = _tensor(data, *part)
                tensors[tensor.name] = tensor
    if not nodes:
        raise ValueError("it contains no graph")
    return nodes, tensors


def _node(data: mmap.mmap, start: int, end: int) -> _Node:
    node = _Node()
    for number, value in _fields(data, start, end):
        if not isinstance(value, tuple):
            continue
        if number == 1:
            node.inputs.append(_text(data, *value))
        elif number == 2:
            node.outputs.append(_text(data, *value))
        elif number == 4:
            node.op = _text(data, *value)
        elif number == 5 and node.op in ("", "Constant"):
            for inner, part in _fields(data, *value):
                if inner == 5 and isinstance(part, tuple):
                    node.constant = _tensor(data, *part).largest
    return node


def _tensor(data: mmap.mmap, start: int, end: int) -> _Tensor:
    tensor = _Tensor()
    kind = 0
    raw: tuple[int, int] | None = None
    floats: list[float] = []
    for number, value in _fields(data, start, end):
        if number == 1:
            tensor.dims += _numbers(data, value)
        elif number == 2 and isinstance(value, int):
            kind = value
        elif number == 8 and isinstance(value, tuple):
            tensor.name = _text(data, *value)
        elif number == 9 and isinstance(value, tuple):
            raw = value
        elif number == 4 and isinstance(value, tuple) and value[1] - value[0] <= 256:
            floats += np.frombuffer(data[value[0] : value[1]], "<f4").tolist()
    dtype = {1: "<f4", 10: "<f2", 11: "<f8"}.get(kind)
    if raw is not None and dtype and raw[1] - raw[0] <= 8 * _LARGEST_CONSTANT:
        floats += np.frombuffer(data[raw[0] : raw[1]], dtype).astype(np.float64).tolist()
    if floats:
        tensor.largest = max(abs(x) for x in floats)
    return tensor


def _numbers(data: mmap.mmap, value: int | tuple[int, int]) -> list[int]:
    """A repeated integer, packed or not."""
    if isinstance(value, int):
        return [value]
    at, out = value[0], []
    while at < value[1]:
        number, at = _varint(data, at)
        out.append(number)
    return out


def _text(data: mmap.mmap, start: int, end: int) -> str:
    return data[start:end].decode("utf-8")


def _fields(data: mmap.mmap, start: int, end: int) -> Iterator[tuple[int, int | tuple[int, int]]]:
    """Field numbers with their values: an integer, or start and end of its bytes."""
    at = start
    while at < end:
        key, at = _varint(data, at)
        number, wire = key >> 3, key & 7
        if wire == 0:
            value, at = _varint(data, at)
            yield number, value
            continue
        if wire == 2:
            length, at = _varint(data, at)
        elif wire in (1, 5):
            length = 8 if wire == 1 else 4
        else:
            raise ValueError(f"unknown wire type {wire} at byte {at}")
        if at + length > end or number == 0:
            raise ValueError(f"a part of {length} bytes at byte {at} does not fit")
        yield number, (at, at + length)
        at += length


def _varint(data: mmap.mmap, at: int) -> tuple[int, int]:
    value, shift = 0, 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
        shift += 7
        if shift > 63:
            raise ValueError(f"a number at byte {at} is too long")

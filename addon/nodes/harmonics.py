"""Node group "Splat View Color": the SH colour of a splat from the scene's camera.

The direction is that from the camera to the splat's mean, as in 3D Gaussian Splatting, so a splat
has one colour in a picture and the nodes compute it once, in any render engine. A mirror or another
view shows the colour for the scene's camera.
"""

from collections.abc import Callable

import bpy
import numpy as np

from ..attributes import BASE, SH, SH_COUNTS
from ..core import sh0_to_rgb, sh_basis
from .graph import Graph, Socket, ensure, inputs, new_group, result, socket, use_group

NAME, BAND = "Splat View Color", "Splat Harmonics"

_Powers = tuple[int, int, int]
_BASIS: tuple[dict[_Powers, float], ...] = (
    {(0, 1, 0): 1},
    {(0, 0, 1): 1},
    {(1, 0, 0): 1},
    {(1, 1, 0): 1},
    {(0, 1, 1): 1},
    {(0, 0, 2): 2, (2, 0, 0): -1, (0, 2, 0): -1},
    {(1, 0, 1): 1},
    {(2, 0, 0): 1, (0, 2, 0): -1},
    {(2, 1, 0): 3, (0, 3, 0): -1},
    {(1, 1, 1): 1},
    {(0, 1, 2): 4, (2, 1, 0): -1, (0, 3, 0): -1},
    {(0, 0, 3): 2, (2, 0, 1): -3, (0, 2, 1): -3},
    {(1, 0, 2): 4, (3, 0, 0): -1, (1, 2, 0): -1},
    {(2, 0, 1): 1, (0, 2, 1): -1},
    {(3, 0, 0): 1, (1, 2, 0): -3},
)
"""The basis functions after the constant one as polynomials of x, y, z, up to a factor each. Degree
4 is left out: it is rare, and would cost every display nine attributes."""
_SOMEWHERE = np.array([0.36, 0.48, 0.8])
"""A unit vector at which no basis function is zero."""


def group() -> bpy.types.NodeTree:
    """The group, built if the file has none: a location in the object's space in, a scene-linear
    colour as a field out."""
    return ensure(bpy.data.node_groups, NAME, _build)


def builders() -> list[Callable[[], bpy.types.ID]]:
    """Functions that build the group's parts and then the group, to be called one per step."""
    return [*(lambda degree=degree: _band(degree) for degree in (1, 2, 3)), group]


def linear(graph: Graph, encoded: Socket) -> Socket:
    """IEC 61966-2-1 decoding of one channel; below zero is black."""
    encoded = graph.math("MAXIMUM", encoded, 0.0)
    low = graph.math("DIVIDE", encoded, 12.92)
    base = graph.math("DIVIDE", graph.math("ADD", encoded, 0.055), 1.055)
    high = graph.math("POWER", base, 2.4)
    return graph.switch("FLOAT", graph.compare("LESS_EQUAL", encoded, 0.04045), high, low)


def _build(name: str) -> bpy.types.NodeTree:
    graph, tree = new_group(name)
    socket(tree, "From", "Vector")
    position = graph.call("GeometryNodeInputPosition")
    towards = graph.vector("SUBTRACT", position, inputs(graph)["From"])
    direction = graph.vector("NORMALIZE", towards)
    middle = float(sh0_to_rgb(0.0))
    factor = float(sh0_to_rgb(1.0)) - middle
    channels = graph.channels(graph.attribute(BASE, "FLOAT_COLOR"))
    base = graph.call("ShaderNodeCombineXYZ", *channels[:3])
    total = graph.vector("MULTIPLY_ADD", base, (factor,) * 3, (middle,) * 3)
    for degree in (1, 2, 3):
        total = graph.vector("ADD", total, use_group(graph, _band(degree), {"Towards": direction}))
    channels = [linear(graph, channel) for channel in graph.separate(total)]
    color = graph.call("FunctionNodeCombineColor", *channels, 1.0)
    result(graph, "Color", "Color", color)
    return tree


def _band(degree: int) -> bpy.types.NodeTree:
    """The part of one degree, which is zero if the splats have no such coefficients.

    A group of its own, because the time to build a tree grows with the square of its size.
    """
    return ensure(bpy.data.node_groups, f"{BAND} {degree}", lambda name: _build_band(name, degree))


def _build_band(name: str, degree: int) -> bpy.types.NodeTree:
    graph, tree = new_group(name)
    socket(tree, "Towards", "Vector")
    powers = _Monomials(graph, graph.separate(inputs(graph)["Towards"]))
    total: Socket | None = None
    for k in range(SH_COUNTS[degree - 1], SH_COUNTS[degree]):
        value: Socket | None = None
        for one, factor in _scaled(k).items():
            term = graph.math("MULTIPLY", powers.of(one), factor)
            value = term if value is None else graph.math("ADD", value, term)
        part = graph.vector("SCALE", graph.attribute(f"{SH}{k}", "FLOAT_VECTOR"), value)
        total = part if total is None else graph.vector("ADD", total, part)
    result(graph, "Sum", "Vector", total)
    return tree


def _scaled(k: int) -> dict[_Powers, float]:
    """Basis function k + 1 with its factor, derived from the core's value of the function."""
    basis = _BASIS[k]
    here = sum(f * float(np.prod(_SOMEWHERE ** np.array(one))) for one, f in basis.items())
    factor = float(sh_basis(3, _SOMEWHERE)[k + 1]) / here
    return {one: f * factor for one, f in basis.items()}


class _Monomials:
    """Products of x, y and z as sockets, each made once."""

    def __init__(self, graph: Graph, axes: list[Socket]) -> None:
        self._graph = graph
        self._made: dict[_Powers, Socket] = {
            (1, 0, 0): axes[0],
            (0, 1, 0): axes[1],
            (0, 0, 1): axes[2],
        }

    def of(self, powers: _Powers) -> Socket:
        """x^a y^b z^c."""
        if powers not in self._made:
            axis = next(i for i in range(3) if powers[i])
            rest = tuple(p - (i == axis) for i, p in enumerate(powers))
            unit = tuple(int(i == axis) for i in range(3))
            self._made[powers] = self._graph.math("MULTIPLY", self.of(unit), self.of(rest))
        return self._made[powers]

"""SuperSplat's compressed PLY against an encoder written from the format's description."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import plyfile
import pytest

from gscore.errors import FormatError, GsError
from gscore.io.ply.splats import read_ply
from gscore.sh import sh0_to_rgb

_BOUNDS = [
    *(f"{end}_{axis}" for end in ("min", "max") for axis in "xyz"),
    *(f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz"),
    *(f"{end}_{axis}" for end in ("min", "max") for axis in "rgb"),
]


def _pack(values: list[float], bits: list[int]) -> int:
    """Numbers in [0, 1] as fields of one uint32, first field highest."""
    out = 0
    for value, width in zip(values, bits, strict=True):
        top = (1 << width) - 1
        out = (out << width) | min(top, max(0, int(np.floor(value * top + 0.5))))
    return out


def _pack_rotation(quat: np.ndarray) -> int:
    """Index of the largest component in two bits, then the others, ten bits each."""
    quat = quat / np.linalg.norm(quat)
    largest = int(np.argmax(np.abs(quat)))
    quat = quat * np.sign(quat[largest])
    out = largest
    for k in range(4):
        if k != largest:
            out = (out << 10) | _pack([quat[k] * np.sqrt(0.5) + 0.5], [10])
    return out


def _encode(
    path: Path,
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    rgba: np.ndarray,
    rest: np.ndarray | None = None,
    *,
    color_bounds: bool = True,
) -> None:
    """Write a compressed PLY; `rest` is channel-major as in an ordinary one."""
    count = len(means)
    chunks = -(-count // 256)
    names = _BOUNDS if color_bounds else _BOUNDS[:12]
    chunk = np.zeros(chunks, [(name, "f4") for name in names])
    vertex = np.zeros(
        count,
        [(f"packed_{name}", "u4") for name in ("position", "rotation", "scale", "color")],
    )
    for c in range(chunks):
        part = slice(256 * c, min(count, 256 * (c + 1)))
        units = []
        for what, axes, values in (
            ("", "xyz", means[part]),
            ("scale_", "xyz", scales[part]),
            ("", "rgb", rgba[part, :3]),
        ):
            low, high = values.min(axis=0), values.max(axis=0)
            if axes == "rgb" and not color_bounds:
                low, high = np.zeros(3), np.ones(3)
            else:
                for k, axis in enumerate(axes):
                    chunk[f"min_{what}{axis}"][c] = low[k]
                    chunk[f"max_{what}{axis}"][c] = high[k]
            units.append((values - low) / np.maximum(high - low, 1e-12))
        for k, i in enumerate(range(part.start, part.stop)):
            vertex["packed_position"][i] = _pack(list(units[0][k]), [11, 10, 11])
            vertex["packed_scale"][i] = _pack(list(units[1][k]), [11, 10, 11])
            vertex["packed_color"][i] = _pack([*units[2][k], rgba[i, 3]], [8, 8, 8, 8])
            vertex["packed_rotation"][i] = _pack_rotation(quats[i])
    elements = [
        plyfile.PlyElement.describe(chunk, "chunk"),
        plyfile.PlyElement.describe(vertex, "vertex"),
    ]
    if rest is not None:
        table = np.zeros(count, [(f"f_rest_{k}", "u1") for k in range(rest.shape[1])])
        for k in range(rest.shape[1]):
            table[f"f_rest_{k}"] = np.clip(np.trunc((rest[:, k] / 8 + 0.5) * 256), 0, 255)
        elements.append(plyfile.PlyElement.describe(table, "sh"))
    plyfile.PlyData(elements, byte_order="<").write(str(path))


@pytest.fixture
def parts(rng: np.random.Generator) -> dict[str, np.ndarray]:
    count = 600
    return {
        "means": rng.uniform(-5, 5, (count, 3)),
        "quats": rng.standard_normal((count, 4)),
        "scales": rng.uniform(-8, 1, (count, 3)),
        "rgba": rng.uniform(0, 1, (count, 4)),
    }


@pytest.mark.parametrize("color_bounds", [True, False])
def test_values_within_half_a_step(
    color_bounds: bool, parts: dict[str, np.ndarray], tmp_path: Path
) -> None:
    """Oracle: the encoded numbers, within half a quantisation step of each field."""
    _encode(tmp_path / "a.ply", **parts, color_bounds=color_bounds)
    splats = read_ply(tmp_path / "a.ply")
    assert len(splats) == 600 and splats.sh_degree == 0
    steps = np.array([1 / 2047, 1 / 1023, 1 / 2047])
    assert (np.abs(splats.means - parts["means"]) <= 10 * steps * 0.51 + 1e-6).all()
    assert (np.abs(splats.scales - parts["scales"]) <= 9 * steps * 0.51 + 1e-6).all()
    rgb = sh0_to_rgb(splats.sh0[:, 0].astype(float))
    assert np.abs(rgb - parts["rgba"][:, :3]).max() <= 0.51 / 255
    alpha = 1 / (1 + np.exp(-splats.opacities.astype(float)))
    assert np.abs(alpha - parts["rgba"][:, 3]).max() <= 0.51 / 255
    unit = parts["quats"] / np.linalg.norm(parts["quats"], axis=1, keepdims=True)
    ours = splats.quats / np.linalg.norm(splats.quats, axis=1, keepdims=True)
    assert np.abs((unit * ours).sum(axis=1)).min() > 1 - 1e-5


@pytest.mark.parametrize("each", [3, 8, 15])
def test_coefficients(
    each: int, parts: dict[str, np.ndarray], tmp_path: Path, rng: np.random.Generator
) -> None:
    """Oracle: coefficients encoded channel-major, within half of a 256th of the range of 8."""
    rest = rng.uniform(-3.9, 3.9, (600, 3 * each))
    _encode(tmp_path / "a.ply", **parts, rest=rest)
    splats = read_ply(tmp_path / "a.ply")
    expected = rest.reshape(600, 3, each).transpose(0, 2, 1)
    assert np.abs(splats.shN - expected).max() <= 0.5 * 8 / 256 + 1e-6


def test_values_by_hand(tmp_path: Path) -> None:
    """Oracle: fields worked out by hand for one splat."""
    chunk = np.zeros(1, [(name, "f4") for name in _BOUNDS])
    for name, value in {"max_x": 2047, "max_y": 1023, "max_z": 2047, "max_r": 1}.items():
        chunk[name] = value
    vertex = np.zeros(
        1, [(f"packed_{n}", "u4") for n in ("position", "rotation", "scale", "color")]
    )
    vertex["packed_position"] = (3 << 21) | (5 << 11) | 7
    # Largest component is y (index 2); w, x at 0.5 + 1/2 (1023 of 1023 gives sqrt(1/2)), z at 0.
    vertex["packed_rotation"] = (2 << 30) | (1023 << 20) | (0 << 10) | 512
    vertex["packed_color"] = (255 << 24) | 255
    elements = [(chunk, "chunk"), (vertex, "vertex")]
    plyfile.PlyData([plyfile.PlyElement.describe(t, n) for t, n in elements]).write(
        str(tmp_path / "a.ply")
    )
    splats = read_ply(tmp_path / "a.ply")
    assert splats.means.tolist() == [[3, 5, 7]]
    assert splats.scales.tolist() == [[0, 0, 0]]
    np.testing.assert_allclose(splats.quats[0], [0.7071, -0.7071, 0.0, 0.0007], atol=1e-3)
    np.testing.assert_allclose(sh0_to_rgb(splats.sh0[0, 0]), [1, 0, 0], atol=1e-6)
    assert 6 < splats.opacities[0] < 8  # opaque, and finite


def test_damaged_layouts(parts: dict[str, np.ndarray], tmp_path: Path) -> None:
    """Oracle: a refusal by name of too few chunks and wrong coefficient names."""
    path = tmp_path / "a.ply"
    _encode(path, **parts, rest=np.zeros((600, 9)))
    data = plyfile.PlyData.read(str(path))
    chunk, vertex, sh = (data[name].data for name in ("chunk", "vertex", "sh"))

    def write(**elements: np.ndarray) -> None:
        plyfile.PlyData([plyfile.PlyElement.describe(t, n) for n, t in elements.items()]).write(
            str(path)
        )

    write(chunk=np.array(chunk[:2]), vertex=np.array(vertex))
    with pytest.raises(FormatError, match=r"2 chunks for 600 splats \(expected 3\)"):
        read_ply(path)
    write(vertex=np.array(vertex))
    with pytest.raises(FormatError, match="missing properties: min_x"):
        read_ply(path)
    write(chunk=np.array(chunk), vertex=np.array(vertex), sh=np.array(sh[:5]))
    with pytest.raises(FormatError, match="element sh has 5 rows"):
        read_ply(path)


def test_hostile(parts: dict[str, np.ndarray], mutations: Callable, tmp_path: Path) -> None:
    """Oracle: splats or one of our errors, for a damaged file; no other exception."""
    path, refused = tmp_path / "a.ply", 0
    few = {name: values[:5] for name, values in parts.items()}
    _encode(path, **few, rest=np.zeros((5, 9)))
    for raw in mutations(path.read_bytes()):
        path.write_bytes(raw)
        try:
            read_ply(path)
        except GsError:
            refused += 1
    assert refused > 20

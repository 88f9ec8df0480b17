"""Captures of two planes with known inverse depth at every pixel, and small ONNX networks."""

import statistics
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from gscore.io.colmap.folder import (
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    ColmapPoints,
    write_model,
)
from gscore.io.images.png import write_png
from gscore.transforms import rotmat_to_quat
from tests.run_verb import gscore  # noqa: F401

PLANES = ((np.array([0.3, 0.1, -1.0]), -4.0), (np.array([-0.9, 0.2, -1.0]), -5.5))
"""Normals n and distances d of the planes n.p = d; the nearer one is visible."""
GREY_PER_INVERSE_DEPTH = 500.0
"""Photos show the inverse depth as grey values."""


class Planes:
    """A capture on disk, and its ground truth."""

    def __init__(self, folder: Path, *, views=5, width=120, height=80, radial=0.0, reach=(0, 9)):
        self.folder, self.width, self.height = folder, width, height
        model = "SIMPLE_RADIAL" if radial else "PINHOLE"
        params = (
            [90.0, width / 2, height / 2, radial] if radial else [90, 90, width / 2, height / 2]
        )
        self.camera = ColmapCamera(
            model=model, width=width, height=height, params=np.array(params, np.float64)
        )
        self.names = [f"cam/v_{i}.png" for i in range(views)]
        self.viewmats = []
        for i in range(views):
            place = 5 * i / views
            angle = 0.08 * (place - 2.5)
            c, s = np.cos(angle), np.sin(angle)
            viewmat = np.eye(4)
            viewmat[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
            viewmat[:3, 3] = [0.2 * (place - 2), 0.05 * place, 0.0]
            self.viewmats.append(viewmat)
        for i, name in enumerate(self.names):
            grey = self.truth(i) * GREY_PER_INVERSE_DEPTH
            assert grey.max() < 255
            grey = np.rint(grey).astype(np.uint8)
            write_png(folder / "images" / name, np.repeat(grey[..., None], 3, 2))
        self._write_model(reach)

    def rays(self, pixels):
        """[..., 3] directions with z = 1 of camera pixels [..., 2]."""
        f, cx, cy = self.camera.params[0], *self.camera.params[-3:-1]
        if self.camera.model == "PINHOLE":
            cx, cy = self.camera.params[2:]
        flat = (np.asarray(pixels) - [cx, cy]) / f
        if self.camera.model == "SIMPLE_RADIAL":
            k, bent = self.camera.params[3], flat
            for _ in range(60):  # fixed point of u (1 + k r^2) = bent
                flat = bent / (1 + k * (flat**2).sum(-1, keepdims=True))
        return np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], -1)

    def inverse_depth(self, index, rays):
        """[...] 1 / camera z of the first surface hit by rays [..., 3] with z = 1."""
        viewmat = self.viewmats[index]
        rotation, translation = viewmat[:3, :3], viewmat[:3, 3]
        center = -rotation.T @ translation
        found = [(rays @ rotation) @ n / (d - n @ center) for n, d in PLANES]
        return np.maximum(*found)

    def truth(self, index, width=None, height=None):
        """[H, W] float64 inverse depth at the pixel centres of the photo at any size."""
        width, height = width or self.width, height or self.height
        x = (np.arange(width) + 0.5) * self.width / width
        y = (np.arange(height) + 0.5) * self.height / height
        return self.inverse_depth(index, self.rays(np.stack(np.meshgrid(x, y), -1)))

    def _write_model(self, reach):
        """80 points for each view, at random pixels of it; only those at inverse depths within
        `reach`."""
        rng = np.random.default_rng(5)
        xyz, self.kept = [], []
        for i in range(len(self.names)):
            pixels = rng.uniform(1, [self.width - 1, self.height - 1], (80, 2))
            rays = self.rays(pixels)
            inverse = self.inverse_depth(i, rays)
            self.kept.append((inverse >= reach[0]) & (inverse <= reach[1]))
            local = rays / inverse[:, None]
            rotation, translation = self.viewmats[i][:3, :3], self.viewmats[i][:3, 3]
            xyz.append((local - translation) @ rotation)
        images = []
        for i, name in enumerate(self.names):
            ids = np.arange(i * 80, i * 80 + 80)
            rotation, translation = self.viewmats[i][:3, :3], self.viewmats[i][:3, 3]
            local = xyz[i] @ rotation.T + translation
            flat = local[:, :2] / local[:, 2:]
            params = self.camera.params
            if self.camera.model == "SIMPLE_RADIAL":
                flat = flat * (1 + params[3] * (flat**2).sum(-1, keepdims=True))
            center = params[1:3] if self.camera.model == "SIMPLE_RADIAL" else params[2:]
            images.append(
                ColmapImage(
                    id=i + 1,
                    name=name,
                    camera_id=1,
                    qvec=rotmat_to_quat(rotation),
                    tvec=translation.copy(),
                    xys=flat * params[0] + center,
                    point3D_ids=np.where(self.kept[i], ids + 1, -1),
                )
            )
        points = np.concatenate(xyz)
        write_model(
            ColmapModel(
                cameras={1: self.camera},
                images=images,
                points=ColmapPoints(
                    ids=np.arange(1, len(points) + 1),
                    xyz=points,
                    rgb=np.full((len(points), 3), 99, np.uint8),
                    error=np.full(len(points), 0.3),
                    track_lengths=np.full(len(points), 3, np.int32),
                ),
            ),
            self.folder / "sparse" / "0",
        )

    def write_maps(self, save, folder="depths", ending=".npy"):
        """Save a map of every view: `save(path, [H, W] inverse depth)`."""
        for i, name in enumerate(self.names):
            path = (self.folder / folder / name).with_suffix(ending)
            path.parent.mkdir(parents=True, exist_ok=True)
            save(path, self.truth(i))


def _official_by_hand(image, points, width, height):
    """The rule in plain Python, one point at a time, by the documentation of the format."""
    rows, columns = len(image), len(image[0])
    ratio = rows / height
    usable = []
    for x, y, inverse in points:
        u, v = x * ratio, y * ratio
        if 0 <= u < width * ratio and 0 <= v < height * ratio and inverse > 0:
            left, top = int(u // 1), int(v // 1)
            fu, fv = u - left, v - top

            def at(row, column):
                return image[min(row, rows - 1)][min(column, columns - 1)]

            mono = (
                at(top, left) * (1 - fu) * (1 - fv)
                + at(top, left + 1) * fu * (1 - fv)
                + at(top + 1, left) * (1 - fu) * fv
                + at(top + 1, left + 1) * fu * fv
            )
            usable.append((mono, inverse))
    inverses = [p[2] for p in points]
    if len(usable) <= 10 or max(inverses) - min(inverses) <= 1e-3:
        return 0.0, 0.0
    middle = statistics.median(s for _, s in usable)
    mono_middle = statistics.median(m for m, _ in usable)
    deviation = sum(abs(s - middle) for _, s in usable) / len(usable)
    mono_deviation = sum(abs(m - mono_middle) for m, _ in usable) / len(usable)
    scale = deviation / mono_deviation
    return scale, middle - mono_middle * scale


@pytest.fixture
def official_by_hand():
    """The official rule in plain Python."""
    return _official_by_hand


@pytest.fixture
def planes(tmp_path):
    """A capture of five views by a pinhole camera."""
    return Planes(tmp_path / "capture")


@pytest.fixture
def make_planes(tmp_path):
    """Such a capture with other options."""

    def make(name="other", **options):
        return Planes(tmp_path / name, **options)

    return make


IMAGENET = (np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225]))
WEIGHTS = np.array([2.0, 3.0, 5.0])
"""The networks return 20 + 2 r + 3 g + 5 b of their input, so that channels cannot be mixed up."""


def _constant(name, values, kind=np.float32):
    return numpy_helper.from_array(np.asarray(values, kind), name)


def _save(path, nodes, entry, output, constants, kind=TensorProto.FLOAT):
    graph = helper.make_graph(
        nodes,
        "net",
        [helper.make_tensor_value_info(entry[0], kind, entry[1])],
        [helper.make_tensor_value_info(output[0], kind, output[1])],
        constants,
    )
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8, producer_name="pytorch"
    )
    onnx.checker.check_model(model)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, str(path))
    return path


def _center_kernel(size):
    """[1, 3, size, size] kernel that returns the weighted colours of the middle tap alone."""
    kernel = np.zeros((1, 3, size, size))
    kernel[0, :, size // 2, size // 2] = WEIGHTS
    return kernel


def midas(path, *, size=256, inside=None, entry="0", half=False, metric=False):
    """Like MiDaS 2.1: convolutions, [1, 3, n, n] to [1, n, n]; `inside`: the network normalises."""
    kind = np.float16 if half else np.float32
    constants = [
        _constant("kernel", _center_kernel(3), kind),
        _constant("bias", [20.0], kind),
        _constant("axis", [1], np.int64),
    ]
    nodes, fed = [], entry
    if inside is not None:
        mean, deviation = inside
        constants += [
            _constant("mean", np.reshape(mean, (1, 3, 1, 1)), kind),
            _constant("deviation", np.reshape(deviation, (1, 3, 1, 1)), kind),
        ]
        nodes += [
            helper.make_node("Sub", [fed, "mean"], ["shifted"]),
            helper.make_node("Div", ["shifted", "deviation"], ["normal"]),
        ]
        fed = "normal"
    nodes += [
        helper.make_node("Conv", [fed, "kernel", "bias"], ["map"], pads=[1, 1, 1, 1]),
        helper.make_node("Sigmoid" if metric else "Relu", ["map"], ["positive"]),
        helper.make_node("Squeeze", ["positive", "axis"], ["797"]),
    ]
    tensor = TensorProto.FLOAT16 if half else TensorProto.FLOAT
    return _save(
        path, nodes, (entry, [1, 3, size, size]), ("797", [1, size, size]), constants, tensor
    )


def transformer(path, *, patch, shape, entry="pixel_values"):
    """Like DPT (patch 16) and Depth Anything (patch 14): patches, attention, a small map.

    Returns the mean of 20 + 2 r + 3 g + 5 b over each patch; the attention adds zero.
    """
    kernel = np.broadcast_to(WEIGHTS[:, None, None] / patch**2, (1, 3, patch, patch))
    constants = [
        _constant("kernel", kernel),
        _constant("bias", [20.0]),
        _constant("axis", [1], np.int64),
        _constant("nothing", 0.0),
    ]
    nodes = [
        helper.make_node("Conv", [entry, "kernel", "bias"], ["map"], strides=[patch, patch]),
        helper.make_node("Softmax", ["map"], ["attention"], axis=3),
        helper.make_node("Mul", ["attention", "nothing"], ["silent"]),
        helper.make_node("Add", ["map", "silent"], ["sum"]),
        helper.make_node("Relu", ["sum"], ["positive"]),
        helper.make_node("Squeeze", ["positive", "axis"], ["predicted_depth"]),
    ]
    return _save(path, nodes, (entry, shape), ("predicted_depth", ["n", "h", "w"]), constants)


def channels_last(path, *, size=256):
    """Like exports from TensorFlow: [1, n, n, 3] to [1, n, n, 1]."""
    constants = [_constant("kernel", _center_kernel(3)), _constant("bias", [20.0])]
    nodes = [
        helper.make_node("Transpose", ["x"], ["first"], perm=[0, 3, 1, 2]),
        helper.make_node("Conv", ["first", "kernel", "bias"], ["map"], pads=[1, 1, 1, 1]),
        helper.make_node("Relu", ["map"], ["positive"]),
        helper.make_node("Transpose", ["positive"], ["y"], perm=[0, 2, 3, 1]),
    ]
    return _save(path, nodes, ("x", [1, size, size, 3]), ("y", [1, size, size, 1]), constants)


def metric_network(path, *, size=256, photo_scale=GREY_PER_INVERSE_DEPTH):
    """Returns depth, 1 / inverse depth, from photos with inverse depth as grey values."""
    kernel = np.zeros((1, 3, 1, 1))
    kernel[0, 0] = 255.0 / photo_scale
    constants = [_constant("kernel", kernel)]
    nodes = [
        helper.make_node("Conv", ["image", "kernel"], ["inverse"]),
        helper.make_node("Reciprocal", ["inverse"], ["depth"]),
    ]
    return _save(
        path, nodes, ("image", [1, 3, size, size]), ("depth", [1, 1, size, size]), constants
    )


@pytest.fixture
def networks():
    """The makers of networks by name."""
    return {
        "midas": midas,
        "transformer": transformer,
        "channels_last": channels_last,
        "metric": metric_network,
    }

"""Files of the capture: pictures, masks, depth, the true cameras and the surface."""

import io
import json
from pathlib import Path

import numpy as np
from PIL import Image

DEPTH_SCALE = 4.0
"""Inverse depth in 1/m = 16-bit value / 65536 * DEPTH_SCALE; depth step z^2 / 16384 metres."""
TEST_EVERY = 6
"""Every 6th view by name is a test view."""


def atomic(path, content):
    """Write bytes atomically: the file is complete or absent."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    part.write_bytes(content)
    part.replace(path)


def encode(array, kind, **options):
    """Bytes of an image file."""
    buffer = io.BytesIO()
    Image.fromarray(array).save(buffer, kind, optimize=True, **options)
    return buffer.getvalue()


def view(folder, name, rgb, mask, depth, quality=87):
    """Write one view.

    Args:
        folder: folder of the capture.
        name: name of the view, without ending.
        rgb: [H, W, 3] sRGB in [0, 1]; mask: [H, W] in [0, 1]; depth: [H, W] metres, inf for none.
        quality: JPEG quality.
    """
    code = np.round(65536 / DEPTH_SCALE / np.maximum(depth, DEPTH_SCALE / 65535))
    picture = np.round(rgb * 255).astype(np.uint8)
    atomic(
        folder / "images" / f"{name}.jpg",
        encode(picture, "JPEG", quality=quality, progressive=True),
    )
    atomic(folder / "masks" / f"{name}.png", encode(np.round(mask * 255).astype(np.uint8), "PNG"))
    atomic(folder / "depths" / f"{name}.png", encode(code.astype(np.uint16), "PNG"))


def surface(path, vertices, triangles):
    """Write triangles as a binary PLY.

    Args:
        path: the file.
        vertices: [V, 3] metres; triangles: [F, 3] rows of `vertices`.
    """
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(triangles), [("count", "u1"), ("rows", "<i4", 3)])
    faces["count"], faces["rows"] = 3, triangles
    atomic(path, head.encode() + vertices.astype("<f4").tobytes() + faces.tobytes())


def truth(folder, names, K, viewmats, width, height, sfm):
    """Write cameras_true.json, test.txt, and the depth scales where 3DGS trainers expect them."""
    views = [
        {"name": f"{n}.jpg", "viewmat": np.round(m, 9).tolist()}
        for n, m in zip(names, viewmats, strict=True)
    ]
    data = {
        "about": "The cameras that rendered the pictures. World to camera, OpenCV axes, metres; "
        "pixel centres at +0.5.",
        "width": width,
        "height": height,
        "K": K.tolist(),
        "depth": {"unit": "1/m", "scale": DEPTH_SCALE / 65536, "zero": "nothing there"},
        "sfm": sfm,
        "views": views,
    }
    folder = Path(folder)
    atomic(folder / "cameras_true.json", (json.dumps(data, indent=1) + "\n").encode())
    test = "".join(f"{n}.jpg\n" for n in names[::TEST_EVERY])
    atomic(folder / "test.txt", test.encode())
    scales = {n: {"scale": DEPTH_SCALE, "offset": 0.0} for n in names}
    atomic(folder / "sparse" / "0" / "depth_params.json", (json.dumps(scales) + "\n").encode())

"""Sixty cameras on three rings around the figure."""

import bpy
import numpy as np
from mathutils import Matrix

RINGS = ((0.55, 2.75, 0.86), (1.25, 2.65, 0.90), (2.05, 2.60, 0.84))
"""Per ring: height of the camera, its distance from the axis, height of its target; metres."""
FIELD = 1.98
"""Height in metres that a picture of `RINGS[1]` covers at the axis of the figure."""


def intrinsics(width, height):
    """[3, 3] float64 intrinsic matrix of all cameras in pixels, with a central principal point."""
    focal = RINGS[1][1] / FIELD * height
    return np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])


def around(views, rng):
    """[views, 4, 4] float64 world to camera, OpenCV axes; ring by ring."""
    mats = []
    for ring, (height, distance, aim) in enumerate(RINGS):
        count = len(range(ring, views, len(RINGS)))
        for k in range(count):
            turn = 2 * np.pi * (k + ring / len(RINGS)) / count + rng.normal(0, 0.02)
            r = distance + rng.normal(0, 0.06)
            eye = np.array([r * np.sin(turn), -r * np.cos(turn), height + rng.normal(0, 0.05)])
            target = np.array([0, 0, aim]) + rng.normal(0, 0.02, 3)
            mats.append(look_at(eye, target, roll=rng.normal(0, 0.015)))
    return np.stack(mats)


def look_at(eye, target, roll=0.0):
    """[4, 4] world to camera of a camera at `eye` with `target` at the centre of its picture."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, (0, 0, 1.0))
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(roll), np.sin(roll)
    rotation = np.stack([c * x + s * y, c * y - s * x, z])
    return np.block([[rotation, -rotation @ eye[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])


def add_camera():
    """Add the only camera of the scene, for `place`."""
    data = bpy.data.cameras.new("camera")
    item = bpy.data.objects.new("camera", data)
    item.rotation_mode = "QUATERNION"
    bpy.context.scene.collection.objects.link(item)
    bpy.context.scene.camera = item
    return item


def place(camera, K, viewmat, width):
    """Set a Blender camera from K with a central principal point and a world-to-camera matrix."""
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.lens = K[0, 0] * camera.data.sensor_width / width
    rotation = viewmat[:3, :3]
    camera.location = -rotation.T @ viewmat[:3, 3]
    # Blender cameras look along -z with y up. A quaternion is more precise than Euler angles.
    camera.rotation_quaternion = Matrix(
        (np.diag([1.0, -1, -1]) @ rotation).T.tolist()
    ).to_quaternion()

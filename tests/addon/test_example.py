"""Oracle: the files that examples/photos_to_blend.py leaves, opened again."""

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from addon.core import Splats, render, write_splats

ROOT = Path(__file__).parent.parent.parent
STUDIO = ROOT / "examples" / "studio"


def test_photos_to_blend(
    scene: bpy.types.Scene,
    run_blender: Callable[..., str],
    make_splats: Callable[..., Splats],
    tmp_path: Path,
) -> None:
    """Oracle: gscore.render with the exact camera kept in the file; the PLY's number of splats."""
    splats, ply = make_splats(3000), tmp_path / "some.ply"
    write_splats(ply, splats)
    blend, picture = tmp_path / "made" / "scene.blend", tmp_path / "picture.png"
    run_blender(
        ROOT / "examples" / "photos_to_blend.py",
        STUDIO,
        *("-o", blend, "--render", picture, "--camera", "view_007.jpg", "--splats", ply),
    )
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    kinds = [ob.get("gs_kind") for ob in bpy.context.scene.objects]
    assert kinds.count("camera") == 60 and kinds.count("splats") == 1
    (ob,) = [ob for ob in bpy.context.scene.objects if ob.get("gs_kind") == "splats"]
    assert len(ob.data.vertices) == 3000 and ob.modifiers
    camera = bpy.context.scene.camera
    assert camera["gs_image"] == "view_007.jpg"
    width, height = camera["gs_size"]
    K, viewmat = np.reshape(camera["gs_K"], (3, 3)), np.reshape(camera["gs_viewmat"], (4, 4))
    expected = render(splats, K, viewmat, width, height)
    image = bpy.data.images.load(str(picture))
    assert tuple(image.size) == (width, height)
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    shown = pixels.reshape(height, width, 4)[::-1, :, :3]
    assert expected.alpha.mean() > 0.05  # an empty file has no world, so black lies behind
    assert np.abs(shown - np.clip(expected.rgb, 0, 1)).max() <= 1 / 255

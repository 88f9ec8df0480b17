"""Soft colours: soft or native splats in Cycles compared to the colours of the engine.

    python tools/measure/soft_colors.py CAPTURE SPLATS [SPLATS ...]    (a Python with bpy)

Renders the capture's first camera (`--camera NAME`, once or more: others) with the engine Gaussian
Splats and with the display Soft Splats (`--display NATIVE`: Blender's own, 5.3), over grey, with
the view transform Standard. Prints the mean and the mean absolute difference of both pictures, 8
bit, per channel, over pixels with an opacity of at least a half, and the mean absolute difference
over all pixels; and the seconds of the second picture. `--against FILE`: the engine renders this
file instead, the model before `gscore refit`. `--keep FOLDER` keeps the pictures.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
CYCLES, SPLATS = "CYCLES", "GSCORE_SPLATS"


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("splats", type=Path, nargs="+", help="splat files of trainings on it")
    parser.add_argument("--camera", action="append", help="name of a photo; default: the first")
    parser.add_argument("--against", type=Path, help="splat file that the engine renders")
    parser.add_argument("--engine", default=CYCLES, help="CYCLES, or EEVEE's name in this Blender")
    parser.add_argument("--display", default="SOFT", choices=("SOFT", "NATIVE"))
    parser.add_argument("--samples", type=int, default=32)
    parser.add_argument("--width", type=int, default=400)
    parser.add_argument("--grey", type=float, default=0.2, help="background, scene-linear")
    parser.add_argument("--keep", type=Path)
    return parser.parse_args()


def prepare(options: argparse.Namespace) -> bpy.types.Scene:
    """Set up cameras of the capture and a grey world, without colour transforms."""
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.gscore.import_cameras(directory=str(options.capture.absolute()))
    scene = bpy.context.scene
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_percentage = 100
    scene.render.dither_intensity = 0.0
    scene.world = bpy.data.worlds.new("grey")
    scene.world.color = (options.grey,) * 3
    scene.cycles.samples, scene.cycles.use_denoising = options.samples, False
    scene.cycles.use_adaptive_sampling = False
    scene.eevee.taa_render_samples = options.samples
    return scene


def use_camera(scene: bpy.types.Scene, name: str, width: int) -> None:
    """Choose a camera of the capture, at a picture width."""
    bpy.ops.gscore.use_camera(camera=name, index=-1 if name else 0, look_through=False)
    height = scene.render.resolution_y * width / scene.render.resolution_x
    scene.render.resolution_x, scene.render.resolution_y = width, round(height)


def imported(scene: bpy.types.Scene, path: Path) -> bpy.types.Object:
    """The splats of a file as an object in their capture."""
    bpy.context.view_layer.objects.active = scene.camera  # import places splats in its capture
    bpy.ops.gscore.import_splats(filepath=str(path.absolute()))
    return bpy.context.object


def picture(scene: bpy.types.Scene, engine: str, path: Path, mode: str = "RGB") -> np.ndarray:
    """Render a picture [H, W, 3 or 4], 8-bit values as floats."""
    scene.render.engine = engine
    scene.render.film_transparent = mode == "RGBA"
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", mode, "8"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path), check_existing=False)
    pixels = np.empty((image.size[1], image.size[0], image.channels), np.float32)
    image.pixels.foreach_get(pixels.ravel())
    bpy.data.images.remove(image)
    return pixels[..., : len(mode)].astype(np.float64) * 255


def compare(
    scene: bpy.types.Scene, path: Path, camera: str, options: argparse.Namespace, folder: Path
) -> None:
    """Print a row."""
    use_camera(scene, camera, options.width)
    name = f"{path.parent.name}_{path.stem}_{Path(camera).stem}"
    ob = imported(scene, options.against or path)
    exact = picture(scene, SPLATS, folder / f"{name}_exact.png")
    covered = picture(scene, SPLATS, folder / f"{name}_alpha.png", "RGBA")[..., 3] >= 127.5
    if options.against is not None:
        bpy.data.objects.remove(ob)
        ob = imported(scene, path)
    ob.gscore.display = options.display
    scene.render.engine = options.engine
    if bpy.ops.gscore.see_through_splats.poll():
        bpy.ops.gscore.see_through_splats()
    started = time.perf_counter()
    shown = picture(scene, options.engine, folder / f"{name}_{options.display.lower()}.png")
    seconds = time.perf_counter() - started
    difference = shown - exact
    inside = difference[covered]
    print(
        f"{path} {camera}: {covered.mean():.0%} covered; R, G, B differ by "
        f"{', '.join(f'{v:+.2f}' for v in inside.mean(axis=0))} of 255 on average, absolute "
        f"{', '.join(f'{v:.2f}' for v in np.abs(inside).mean(axis=0))}, over all pixels "
        f"{np.abs(difference).mean():.2f}; {seconds:.1f} s",
        flush=True,
    )
    bpy.data.objects.remove(ob)


def main() -> None:
    """Measure and print."""
    options = parse()
    sys.path.insert(0, str(ROOT))
    import addon

    addon.register()
    try:
        scene = prepare(options)
        print(f"Blender {bpy.app.version_string}, {options.engine}, {options.samples} samples")
        with tempfile.TemporaryDirectory() as name:
            folder = options.keep or Path(name)
            folder.mkdir(parents=True, exist_ok=True)
            for camera in options.camera or [""]:
                for path in options.splats:
                    compare(scene, path, camera, options, folder.absolute())
    finally:
        addon.unregister()
        sys.stdout.flush()


if __name__ == "__main__":
    main()

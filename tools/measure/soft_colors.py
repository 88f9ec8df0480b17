"""Soft colours: soft or native splats in Cycles compared to the colours of the engine.

    python tools/measure/soft_colors.py CAPTURE SPLATS [SPLATS ...]    (a Python with bpy)

Renders the capture's first camera with the engine Gaussian Splats and with the display Soft Splats
(`--display NATIVE`: Blender's own, 5.3), over grey, with the view transform Standard. Prints the
mean and the mean absolute difference of both pictures, 8 bit, per channel, over pixels with an
opacity of at least a half; and the seconds of the second picture. `--keep FOLDER` keeps the
pictures.
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
    parser.add_argument("--camera", default="", help="name of a photo; default: the first")
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
    index = -1 if options.camera else 0
    bpy.ops.gscore.use_camera(camera=options.camera, index=index, look_through=False)
    scene = bpy.context.scene
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_percentage = 100
    height = scene.render.resolution_y * options.width / scene.render.resolution_x
    scene.render.resolution_x, scene.render.resolution_y = options.width, round(height)
    scene.render.dither_intensity = 0.0
    scene.world = bpy.data.worlds.new("grey")
    scene.world.color = (options.grey,) * 3
    scene.cycles.samples, scene.cycles.use_denoising = options.samples, False
    scene.cycles.use_adaptive_sampling = False
    scene.eevee.taa_render_samples = options.samples
    return scene


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


def compare(scene: bpy.types.Scene, path: Path, options: argparse.Namespace, folder: Path) -> None:
    """Print a row."""
    bpy.context.view_layer.objects.active = scene.camera  # import places splats in its capture
    bpy.ops.gscore.import_splats(filepath=str(path.absolute()))
    ob = bpy.context.object
    name = f"{path.parent.name}_{path.stem}"
    exact = picture(scene, SPLATS, folder / f"{name}_exact.png")
    covered = picture(scene, SPLATS, folder / f"{name}_alpha.png", "RGBA")[..., 3] >= 127.5
    ob.gscore.display = options.display
    scene.render.engine = options.engine
    if bpy.ops.gscore.see_through_splats.poll():
        bpy.ops.gscore.see_through_splats()
    started = time.perf_counter()
    shown = picture(scene, options.engine, folder / f"{name}_{options.display.lower()}.png")
    seconds = time.perf_counter() - started
    apart = (shown - exact)[covered]
    print(
        f"{path}: {covered.mean():.0%} covered; R, G, B differ by "
        f"{', '.join(f'{v:+.2f}' for v in apart.mean(axis=0))} of 255 on average, absolute "
        f"{', '.join(f'{v:.2f}' for v in np.abs(apart).mean(axis=0))}; {seconds:.1f} s",
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
            for path in options.splats:
                compare(scene, path, options, folder.absolute())
    finally:
        addon.unregister()
        sys.stdout.flush()


if __name__ == "__main__":
    main()

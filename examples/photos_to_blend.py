"""Make a .blend file of splats and a render of them from photos with COLMAP cameras, headless.

    blender -b -P examples/photos_to_blend.py -- photos/ -o scene.blend     (the add-on installed)
    python examples/photos_to_blend.py photos/ -o scene.blend               (Python with bpy)

The splats are trained into the folder `--run`, or read from the PLY of `--splats`. The render is
written next to the .blend (here scene.png). The script calls operators of the add-on, the same as
the buttons of its panels.
"""

import argparse
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

try:
    import bpy
except ModuleNotFoundError:
    sys.exit(
        f"{sys.executable} has no bpy. Run this script with .venv-blender/VERSION/bin/python, "
        "which `make demo` makes, or in Blender: blender -b -P examples/photos_to_blend.py -- ..."
    )

ROOT = Path(__file__).resolve().parent.parent
EXTENSION = "gscore_splats"


def enable_addon() -> str:
    """Enable the installed extension or, without one, this checkout's add-on; return its name."""
    import addon_utils  # available after the import of bpy

    extensions = Path(bpy.utils.user_resource("EXTENSIONS"))
    name = f"bl_ext.user_default.{EXTENSION}"
    if not (extensions / "user_default" / EXTENSION).is_dir():
        sys.path.insert(0, str(ROOT))
        name = "addon"
    if addon_utils.enable(name, default_set=True) is None:
        sys.exit("The add-on could not be enabled; see the messages above.")
    return name


def parse() -> argparse.Namespace:
    """Arguments after `--` in the Blender program, all arguments with the bpy module."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path, help="folder with photos and a COLMAP model")
    parser.add_argument("-o", "--output", type=Path, required=True, help=".blend file to write")
    parser.add_argument("--render", type=Path, help="PNG to render to; default: OUTPUT.png")
    parser.add_argument("--camera", default="", help="name of the photo to render; default: first")
    parser.add_argument("--splats", type=Path, help="PLY of splats; default: train them")
    parser.add_argument("--run", type=Path, help="folder of the training; default: OUTPUT_run")
    parser.add_argument(
        "--overwrite", action="store_true", help="replace the .blend, the picture and the run"
    )
    parser.add_argument("--preset", default="preview", help="preset of the training")
    parser.add_argument(
        "--python",
        type=Path,
        help="Python with gscore[train]; default: that of this checkout, else that of the add-on",
    )
    arguments = sys.argv[1:]
    if bpy.app.binary_path:
        arguments = arguments[arguments.index("--") + 1 :] if "--" in arguments else []
    options = parser.parse_args(arguments)
    options.output = options.output.absolute()
    options.render = (options.render or options.output.with_suffix(".png")).absolute()
    beside = ROOT / ".venv"  # the add-on accepts the folder of an environment, too
    options.python = options.python or (beside if beside.is_dir() else None)
    options.run = (options.run or options.output.with_name(options.output.stem + "_run")).absolute()
    check(options, parser.error)
    return options


def check(options: argparse.Namespace, refuse: Callable[[str], None]) -> None:
    """Report invalid paths and existing output files before any work."""
    for path, ending in ((options.output, ".blend"), (options.render, ".png")):
        if path.suffix.lower() != ending:
            refuse(f"{path} does not end in {ending}; give a name with this ending.")
    if not options.capture.is_dir():
        what = "is a file" if options.capture.exists() else "does not exist"
        refuse(f"{options.capture} {what}; give a folder with photos and a COLMAP model.")
    written = [options.output, options.render]
    if options.splats is None:
        written.append(options.run / "config.json")
    taken = [str(path) for path in written if path.exists()]
    if taken and not options.overwrite:
        refuse(
            f"{' and '.join(taken)} would be replaced. Choose another -o, --render or --run, or "
            "give --overwrite."
        )


def train(options: argparse.Namespace, addon: str) -> None:
    """Train in another process, wait for its end, and load the splats into the scene."""
    settings = bpy.context.scene.gscore
    settings.capture_path = str(options.capture.absolute())
    settings.output_path = str(options.run)
    settings.preset = options.preset
    if options.python:
        preferences = bpy.context.preferences.addons[addon].preferences
        preferences.python_path = str(options.python.absolute())
    bpy.ops.gscore.train(overwrite=options.overwrite, wait=True)


def take_masks_as(run: Path) -> None:
    """Set the masks of comparisons to those of the training that wrote the splats in a folder."""
    try:
        data = json.loads((run / "config.json").read_text(encoding="utf-8"))["data"]
        mode, inverted = data["mask_mode"], data["invert_masks"]
    except (OSError, ValueError, KeyError):
        return  # splats of another program
    settings = bpy.context.scene.gscore
    settings.use_masks, settings.invert_masks = mode != "none", inverted
    if mode != "none":
        settings.mask_mode = mode


def print_report_psnr(run: Path) -> None:
    """Print how the PSNR of a comparison differs from that of the run's report, if any."""
    try:
        metrics = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
        views, mean = metrics["views"], metrics.get("psnr_masked", metrics["psnr"])
        size = f"{views[0]['width']} x {views[0]['height']} px"
        report = f"{mean:.2f} dB: the mean of {len(views)} views at {size}"
    except (OSError, ValueError, LookupError, TypeError):
        return  # splats of another program, or of a stopped run
    print(
        "This PSNR is of one photo at its full resolution. The report of the run has "
        f"{report}, the resolution of the training."
    )


def save(path: Path) -> None:
    """Write the .blend file, without a backup: it is written several times."""
    path.parent.mkdir(parents=True, exist_ok=True)
    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(path))


def make(options: argparse.Namespace, addon: str) -> None:
    """Import, train, save, render, save, compare, save."""
    bpy.ops.gscore.import_cameras(directory=str(options.capture.absolute()))
    if options.splats:
        bpy.ops.gscore.import_splats(filepath=str(options.splats.absolute()))
        take_masks_as(options.splats.absolute().parent)
    else:
        train(options, addon)
    save(options.output)  # first, so that the training is not lost if a later step fails
    index = -1 if options.camera else 0
    bpy.ops.gscore.use_camera(camera=options.camera, index=index, look_through=False)
    bpy.ops.gscore.use_engine()
    bpy.context.scene.render.filepath = str(options.render)
    bpy.ops.render.render(write_still=True)
    save(options.output)
    print(f"Wrote {options.output} and {options.render}")
    bpy.ops.gscore.compare_photo()
    print_report_psnr(options.splats.absolute().parent if options.splats else options.run)
    save(options.output)  # with the comparison


def main() -> int:
    """Make the file in an empty scene; return the exit code."""
    import addon_utils

    options = parse()
    bpy.ops.wm.read_homefile(use_empty=True)
    addon = enable_addon()
    try:
        make(options, addon)
    except RuntimeError:  # of a failed operator, whose message Blender has printed
        return 1
    finally:
        addon_utils.disable(addon)  # bpy 4.5 hangs at exit with an add-on enabled
    return 0


if __name__ == "__main__":
    code = main()
    if bpy.app.version < (4, 5) and not bpy.app.binary_path:
        sys.stdout.flush()
        os._exit(code)  # else bpy 4.2 frees its panels after the end of Python, and crashes
    if code:
        sys.exit(code)

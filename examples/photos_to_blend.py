"""From photos with COLMAP cameras to splats in a .blend file and a picture of them, with no window.

    blender -b -P examples/photos_to_blend.py -- photos/ -o scene.blend     (the add-on installed)
    python examples/photos_to_blend.py photos/ -o scene.blend               (Python with bpy)

Splats are trained into the folder `--run`, or taken from the PLY that `--splats` names. The picture
lands beside the .blend, as scene.png here. Everything here is an operator of the add-on; the
panel's buttons call the same ones.
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
        f"{sys.executable} has no bpy. Run this with .venv-blender/VERSION/bin/python, which "
        "`make demo` makes, or in Blender: blender -b -P examples/photos_to_blend.py -- ..."
    )

ROOT = Path(__file__).resolve().parent.parent
EXTENSION = "gscore_splats"


def enable_addon() -> str:
    """Enable the installed extension or, without one, this checkout's add-on; the name it has."""
    import addon_utils  # there once bpy is

    extensions = Path(bpy.utils.user_resource("EXTENSIONS"))
    name = f"bl_ext.user_default.{EXTENSION}"
    if not (extensions / "user_default" / EXTENSION).is_dir():
        sys.path.insert(0, str(ROOT))
        name = "addon"
    if addon_utils.enable(name, default_set=True) is None:
        sys.exit("The add-on cannot be enabled; the lines above say why.")
    return name


def parse() -> argparse.Namespace:
    """Arguments after `--` in a Blender program, all of them in the bpy module."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path, help="folder with photos and a COLMAP model")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the .blend to write")
    parser.add_argument("--render", type=Path, help="picture to render; default: OUTPUT.png")
    parser.add_argument("--camera", default="", help="name of a photo; default: the first")
    parser.add_argument("--splats", type=Path, help="a PLY; default: train")
    parser.add_argument("--run", type=Path, help="folder of the training; default: OUTPUT_run")
    parser.add_argument(
        "--overwrite", action="store_true", help="replace the .blend, the picture and the run"
    )
    parser.add_argument("--preset", default="preview", help="of the training")
    parser.add_argument(
        "--python", type=Path, help="with gscore[train]; default: this checkout's, or the add-on's"
    )
    arguments = sys.argv[1:]
    if bpy.app.binary_path:
        arguments = arguments[arguments.index("--") + 1 :] if "--" in arguments else []
    options = parser.parse_args(arguments)
    options.output = options.output.absolute()
    options.render = (options.render or options.output.with_suffix(".png")).absolute()
    beside = ROOT / ".venv"  # the add-on takes the folder of an environment too
    options.python = options.python or (beside if beside.is_dir() else None)
    options.run = (options.run or options.output.with_name(options.output.stem + "_run")).absolute()
    check(options, parser.error)
    return options


def check(options: argparse.Namespace, refuse: Callable[[str], None]) -> None:
    """Refuse what cannot be made, and what would replace files, before any work."""
    for path, ending in ((options.output, ".blend"), (options.render, ".png")):
        if path.suffix.lower() != ending:
            refuse(f"{path} does not end in {ending}; give a name that does.")
    if not options.capture.is_dir():
        what = "is a file" if options.capture.exists() else "is not there"
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
    """Train in another process and wait; the splats then stand in the scene."""
    settings = bpy.context.scene.gscore
    settings.capture_path = str(options.capture.absolute())
    settings.output_path = str(options.run)
    settings.preset = options.preset
    if options.python:
        preferences = bpy.context.preferences.addons[addon].preferences
        preferences.python_path = str(options.python.absolute())
    bpy.ops.gscore.train(overwrite=options.overwrite, wait=True)


def take_masks_as(run: Path) -> None:
    """Let masks count in comparisons as they did in the training that left splats in a folder."""
    try:
        data = json.loads((run / "config.json").read_text(encoding="utf-8"))["data"]
        mode, inverted = data["mask_mode"], data["invert_masks"]
    except (OSError, ValueError, KeyError):
        return  # splats from elsewhere
    settings = bpy.context.scene.gscore
    settings.use_masks, settings.invert_masks = mode != "none", inverted
    if mode != "none":
        settings.mask_mode = mode


def tell_of_report(run: Path) -> None:
    """Say why the PSNR of a comparison is not the one in a run's report, if there is one."""
    try:
        metrics = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
        views, mean = metrics["views"], metrics.get("psnr_masked", metrics["psnr"])
        size = f"{views[0]['width']} x {views[0]['height']} px"
        report = f"{mean:.2f} dB: the mean of {len(views)} views at {size}"
    except (OSError, ValueError, LookupError, TypeError):
        return  # splats from elsewhere, or of a run that was stopped
    print(f"That is of one photo at its own size. The run's report has {report}, as it trained.")


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
    save(options.output)  # before anything else may fail: a training is not lost
    index = -1 if options.camera else 0
    bpy.ops.gscore.use_camera(camera=options.camera, index=index, look_through=False)
    bpy.ops.gscore.use_engine()
    bpy.context.scene.render.filepath = str(options.render)
    bpy.ops.render.render(write_still=True)
    save(options.output)
    print(f"Wrote {options.output} and {options.render}")
    bpy.ops.gscore.compare_photo()
    tell_of_report(options.splats.absolute().parent if options.splats else options.run)
    save(options.output)  # with the comparison


def main() -> int:
    """Make the file in an empty scene; the exit code."""
    import addon_utils

    options = parse()
    bpy.ops.wm.read_homefile(use_empty=True)
    addon = enable_addon()
    try:
        make(options, addon)
    except RuntimeError:  # an operator that failed; Blender has printed its sentence
        return 1
    finally:
        addon_utils.disable(addon)  # bpy 4.5 hangs at exit with an add-on enabled
    return 0


if __name__ == "__main__":
    code = main()
    if bpy.app.version < (4, 5) and not bpy.app.binary_path:
        sys.stdout.flush()
        os._exit(code)  # else bpy 4.2 frees its panels when there is no Python, and crashes
    if code:
        sys.exit(code)

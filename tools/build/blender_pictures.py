"""Blender pictures: renders the add-on's panels for docs/blender/.

`GSCORE_BLENDER=PROGRAM python tools/build/blender_pictures.py [NAME...]` needs Blender 4.2 or
later, Xvfb, ImageMagick, and a Python that trains. Default: all pictures. It trains the example
capture first; without a graphics card everything takes six minutes. Check each picture before you
commit it.
"""

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageChops

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from gscore.commands.pictures.video import write_video  # noqa: E402 - the path comes first
from tools.window import programs  # noqa: E402

PAGES = ROOT / "docs" / "blender"
SCRIPT = ROOT / "tools" / "window" / "pictures_scene.py"
SCREENS = (1060, 820), (1060, 1180)
"""Sizes of the window before and after the training."""
VIEW, SMALL = (60, 80, 775, 795), (560, 560)
"""Part of the screen that shows the 3D view, and its size in the animation."""
LONGEST = 900
WHOLE = tuple(f"tour-{number:02}" for number in range(1, 11))
ANIMATION = "growing"
"""Frames of the training, as an animated WebP for the README."""
RATE = 6
"""Frames per second of the video."""
PAUSE, LAST = 0.4, 2.5
"""Seconds of each frame of the animation, and of the last one."""
EMPTY = 1.0
"""Mean difference from the first frame, levels of 255, up to which a frame shows no splats."""
MONTAGES = {
    "region": {"region": "1060x1010+0+0"},
    "handles": {"handles": "1060x960+0+220"},
    "guides": {"part_guides": "1060x830+0+60"},
    "soft": {"part_soft": "240x420+410+350", "part_ellipsoids": "240x420+410+350"},
    "behind": {"part_photo": "620x700+230+230"},
    "frames": {"part_sequence": "290x300+770+832"},
    "torn": {"part_torn": "290x250+770+222"},
    "environment": {"part_question": "560x332+38+341"},
}
"""Crops of screenshots that form each picture, side by side."""


def main() -> None:
    """Run the command line."""
    blender, problem = programs.find(*programs.PICTURES)
    if not blender:
        sys.exit(problem)
    with tempfile.TemporaryDirectory() as place:
        first, second = Path(place, "first"), Path(place, "second")
        first.mkdir()
        shutil.copytree(ROOT / "examples" / "studio", second / "studio")
        photos = sorted((ROOT / "examples" / "studio" / "images").iterdir())
        pixels = (np.asarray(Image.open(photo, formats=["JPEG"])) for photo in photos)
        write_video(first / "walk.mp4", pixels, fps=RATE)
        for folder in (first, second):
            (folder / "python").write_text(sys.executable)
        take(blender, first, SCREENS[0])
        take(blender, second, SCREENS[1])
        shots = {file.stem: file for file in Path(place).glob("*/*.png")}
        for name in sys.argv[1:] or (*WHOLE, *MONTAGES, ANIMATION):
            if name == ANIMATION:
                animate([shots[shot] for shot in sorted(shots) if shot.startswith(ANIMATION)])
                continue
            parts = MONTAGES.get(name, {name: ""})
            command = ["convert"]
            for part, cut in parts.items():
                command += ["(", str(shots[part]), *(["-crop", cut, "+repage"] if cut else []), ")"]
            target = PAGES / f"{name}.jpg"
            subprocess.run([*command, "+append", "-quality", "82", str(target)], check=True)
            print(target.relative_to(ROOT))


def animate(shots: list[Path]) -> None:
    """Write the animation from screens of a training, without Blender's header and sidebar, and
    without screens taken while splats are replaced, which show none, as the first one does."""
    screens = (Image.open(shot, formats=["PNG"]).convert("RGB") for shot in shots)
    empty, *others = [screen.crop(VIEW).resize(SMALL) for screen in screens]
    frames = [empty, *(other for other in others if _difference(other, empty) > EMPTY)]
    target = PAGES / f"{ANIMATION}.webp"
    pauses = [round(1000 * PAUSE)] * (len(frames) - 1) + [round(1000 * LAST)]
    frames[0].save(
        target, save_all=True, append_images=frames[1:], duration=pauses, loop=0, quality=70
    )
    print(target.relative_to(ROOT))


def _difference(a: Image.Image, b: Image.Image) -> float:
    return float(np.asarray(ImageChops.difference(a, b)).mean())


def take(blender: str, folder: Path, size: tuple[int, int]) -> None:
    """Run Blender, which writes its pictures to a folder."""
    with programs.screen(*size) as display:
        options = (size, LONGEST, "--enable-event-simulate")
        output = programs.run(blender, SCRIPT, folder, display, *options)
    results = folder / "seen.json"
    log = json.loads(results.read_text())["log"] if results.is_file() else [output]
    if log:
        sys.exit("\n".join(log))


if __name__ == "__main__":
    main()

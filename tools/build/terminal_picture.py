"""Terminal picture, docs/terminal.png: a first session in a terminal of 80 columns.

    .venv/bin/python tools/build/terminal_picture.py docs/terminal.png

Runs commands on examples/studio in a pseudo-terminal, and draws the screen during the training and
after the last command. Takes a minute; needs the font DejaVu Sans Mono (Debian: fonts-dejavu-core).
"""

import argparse
import math
import os
import pty
import subprocess
import sys
import tempfile
from pathlib import Path

import pyte
from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).parents[2]
STUDIO = ROOT / "examples" / "studio"
COLUMNS = 80
FONT = Path("/usr/share/fonts/truetype/dejavu/DejaVuSansMono.ttf")
COMMANDS = (
    "gscore info studio",
    "gscore train studio -o run --preset preview --eval",
    "gscore render run -o orbit.mp4",
    "gscore eval run --split test",
)
UNDER_WAY = ("step ", 0.55)
"""Text and position (share of the steps) of the progress line to draw."""
INK, PAPER, PROMPT = (222, 222, 214), (28, 30, 34), (120, 190, 120)


def main() -> int:
    """Run the commands, draw and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "studio").symlink_to(STUDIO)
        lines = []
        for command in COMMANDS:
            moving, shown = run(command, Path(folder))
            last = next((i for i, line in enumerate(shown) if line.startswith("Finished")), 0)
            lines += [f"$ {command}", *shown[:last], *moving, *shown[last:], ""]
    picture = draw(lines[:-1])
    picture.save(args.output, optimize=True)
    print(f"{args.output}: {args.output.stat().st_size / 1000:.0f} kB, {len(lines)} lines")
    return 0


def run(command: str, folder: Path) -> tuple[list[str], list[str]]:
    """Progress line in the middle of a training, if any, and the final lines of the screen."""
    near, far = pty.openpty()
    words = [sys.executable, "-m", "gscore", *command.split()[1:]]
    env = os.environ | {"TERM": "xterm", "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(words, stdin=far, stdout=far, stderr=far, cwd=folder, env=env) as process:
        os.set_inheritable(far, False)
        subprocess.run(["stty", "cols", str(COLUMNS), "rows", "60"], stdin=far, check=True)
        os.close(far)
        text = ""
        while chunk := _read(near):
            text += chunk
        if process.wait():
            raise SystemExit(f"{command} failed:\n{text}")
    parts = [part for part in text.replace("\n", "\r").split("\r") if part.startswith("[")]
    steps = [part.rstrip() for part in parts if UNDER_WAY[0] in part]
    middle = steps[int(UNDER_WAY[1] * len(steps)) : int(UNDER_WAY[1] * len(steps)) + 1]
    screen = pyte.Screen(COLUMNS, 60)
    pyte.Stream(screen).feed(text)
    shown = [line.rstrip() for line in screen.display]
    while shown and not shown[-1]:
        shown.pop()
    return middle, shown


def _read(near: int) -> str:
    try:
        return os.read(near, 65536).decode("utf-8", "replace")
    except OSError:  # on Linux, the program has ended
        return ""


def draw(lines: list[str]) -> Image.Image:
    """Draw the lines in a dark window."""
    font = ImageFont.truetype(str(FONT), 14)
    width, height = math.ceil(font.getlength("M" * COLUMNS)), 19
    picture = Image.new("RGB", (width + 32, len(lines) * height + 32), PAPER)
    pen = ImageDraw.Draw(picture)
    for row, line in enumerate(lines):
        color = PROMPT if line.startswith("$ ") else INK
        pen.text((16, 16 + row * height), line, font=font, fill=color)
    return picture.quantize(16)


if __name__ == "__main__":
    sys.exit(main())

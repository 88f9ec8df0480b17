"""Video summary of `gscore info`: its frames, and the next step."""

from pathlib import Path
from typing import Any

from ..quoting import as_typed
from ..text_format import count_text, time_text
from ..video.source import opened_video


def video_facts(path: Path) -> dict[str, Any]:
    """Facts on a video as JSON values; only the first frames are decoded.

    Raises:
        BackendError: PyAV is not installed.
        GsError: not a video, damaged, encrypted or of an unsupported codec.
    """
    with opened_video(path) as video:
        facts = video.facts
    width, height = round(facts.width * max(facts.aspect, 1)), facts.height
    if facts.aspect < 1:
        height = round(height / facts.aspect)
    if facts.rotation in (90, 270):
        width, height = height, width
    return {
        "kind": "video",
        "path": str(path),
        "width": width,
        "height": height,
        "frames": facts.frames,
        "seconds": round(facts.seconds, 2),
        "codec": facts.codec,
        "hdr": facts.hdr,
        "interlaced": facts.interlaced,
        "rotation": facts.rotation,
        "next": as_typed("train", path, "-o", "run"),
        "warnings": [],
    }


def video_text(facts: dict[str, Any]) -> list[str]:
    """The facts as lines of text."""
    known = [count_text(facts["frames"], "frame")] if facts["frames"] else []
    known += [time_text(facts["seconds"])] if facts["seconds"] else []
    known += [f"{facts['width']} x {facts['height']} px", facts["codec"]]
    known += [facts["hdr"]] if facts["hdr"] else []
    known += ["interlaced"] if facts["interlaced"] else []
    return [
        f"{facts['path']}: a video, {', '.join(known)}",
        "  training extracts 30 to 300 sharp frames as photos and finds their cameras",
        f"Next: {facts['next']}",
    ]

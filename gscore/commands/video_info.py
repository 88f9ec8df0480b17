"""Video summary of `gscore info`: its frames, and the next step."""

from pathlib import Path
from typing import Any

from ..quoting import as_typed
from ..text_format import count_words, time_words
from ..video.source import opened_video


def video_facts(path: Path) -> dict[str, Any]:
    """For JSON; the first frames alone are decoded.

    Raises:
        BackendError: PyAV is not installed.
        GsError: it is no video, damaged, encrypted or of a codec that is not there.
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
    """For people."""
    known = [count_words(facts["frames"], "frame")] if facts["frames"] else []
    known += [time_words(facts["seconds"])] if facts["seconds"] else []
    known += [f"{facts['width']} x {facts['height']} px", facts["codec"]]
    known += [facts["hdr"]] if facts["hdr"] else []
    known += ["interlaced"] if facts["interlaced"] else []
    return [
        f"{facts['path']}: a video, {', '.join(known)}",
        "  sharp frames are taken as photos, 30 to 300 of them, and their cameras found",
        f"Next: {facts['next']}",
    ]

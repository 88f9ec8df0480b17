"""Poses section of the report: how far pose refinement moved the cameras."""

import html
from collections.abc import Mapping
from typing import Any

_MOST = 20
"""Cameras that are listed, those that moved farthest."""


def poses_html(poses: Mapping[str, Any]) -> str:
    """The section.

    Args:
        poses: `why`; `cameras`, by name of the photo, with `degrees` and `extents`.
    """
    cameras = sorted(poses["cameras"].items(), key=lambda item: -item[1]["degrees"])
    widest = max((one["degrees"] for _, one in cameras), default=0.0) or 1.0
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{one['degrees']:.3f}</td>"
        f"<td>{100 * one['extents']:.2f} %</td>"
        f'<td><svg width="120" height="10"><rect width="{120 * one["degrees"] / widest:.1f}" '
        f'height="10" fill="currentColor"/></svg></td></tr>'
        for name, one in cameras[:_MOST]
    )
    more = f" The {_MOST} of {len(cameras)} that turned most." if len(cameras) > _MOST else ""
    return (
        f'<section id="poses"><h2>Cameras that were moved</h2><p class="hint">'
        f"{html.escape(poses['why'])}{more}</p>"
        "<table><thead><tr><th>photo</th><th>turned, degrees</th><th>moved, of the extent</th>"
        f"<th></th></tr></thead><tbody>{rows}</tbody></table></section>\n"
    )

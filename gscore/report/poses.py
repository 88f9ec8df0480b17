"""Poses section of the report: changes of the cameras by pose refinement."""

import html
from collections.abc import Mapping
from typing import Any

_MOST = 20
"""Maximum number of listed cameras, those with the largest rotations."""


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
    more = f" Largest {_MOST} rotations of {len(cameras)}." if len(cameras) > _MOST else ""
    return (
        f'<section id="poses"><h2>Refined camera poses</h2><p class="hint">'
        f"{html.escape(poses['why'])}{more}</p>"
        "<table><thead><tr><th>photo</th><th>rotation, degrees</th><th>move, of the extent</th>"
        f"<th></th></tr></thead><tbody>{rows}</tbody></table></section>\n"
    )

"""Capture inspection: its contents and Blender's support of them, as text for the panel; no bpy."""

from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path

from ..core import NO_PINHOLE, CaptureFacts, DataConfig, Problem, find_capture, inspect_capture
from .depth_maps import DepthReport, from_table

DEPTHS = "depths"
"""Folder of the depth maps in a capture."""


class ShownFacts(CaptureFacts):
    """Facts of a capture with the text for panels."""

    @cached_property
    def depth_report(self) -> DepthReport:
        """Depth report from stored scales, without reading the maps; always the same object."""
        return from_table(() if self.depth is None else self.depth.table)

    def lines(self) -> list[tuple[str, str]]:
        """Label and value of each finding, for a panel."""
        sizes = [f"{w} x {h} px" for w, h in self.sizes]
        if self.bare and self.photos:
            size = sizes[0] if len(sizes) == 1 else f"{len(sizes)} different"
            return [("Photos", str(self.photos)), ("Size", size)]
        if not self.kind:
            return []
        rows = [
            (self.kind, str(self.model or self.source)),
            ("Photos", f"{self.photos} of {self.photos + len(self.missing)}"),
            ("Size", sizes[0] if len(sizes) == 1 else f"{len(sizes)} different"),
            ("Cameras", ", ".join(_lenses(self.camera_models))),
            ("Points", f"{self.points:,}"),
        ]
        masks = f"{self.masks} files" if self.masks else f"{self.alphas} photos with alpha"
        if self.masks or self.alphas:
            rows.append(("Masks", masks))
        if self.depths or self.depth_params:
            rows.append(("Depths", f"{self.depths} maps, {self.depth_params} scales"))
        return rows


def _lenses(models: Mapping[str, int]) -> Iterator[str]:
    """Number of cameras and kind, for each kind of lens; undistorted lenses have no kind."""
    counts = Counter[str]()
    for name, count in models.items():
        counts[_kind_of(name)] += count
    return (f"{count} {kind}".rstrip() for kind, count in counts.items())


def _kind_of(model: str) -> str:
    """The kind of lens of a COLMAP camera model, for panels."""
    if model in NO_PINHOLE:
        return "panoramic"
    if model.endswith("FISHEYE"):
        return "fisheye"
    return "" if model.endswith("PINHOLE") else "with lens distortion"


def inspect(path: str | Path, *, images: str = "images") -> ShownFacts:
    """Inspect a capture; never raises for a bad one, its facts list the problems.

    Args:
        path: Path chosen by the user.
        images: Folder of the photos in a COLMAP capture.
    """
    if not str(path):
        problem = Problem(is_error=True, text="Choose a folder of photos, or a video.")
        return ShownFacts(source=Path(), problems=(problem,))
    config = DataConfig(source=find_capture(path), images=images)
    facts = inspect_capture(config, depths=DEPTHS)
    notes = [Problem(is_error=False, text=text) for text in _blender_limits(facts)]
    return ShownFacts(**{**vars(facts), "problems": (*facts.problems, *notes)})


def _blender_limits(facts: CaptureFacts) -> list[str]:
    """Sentences on photos and cameras that training supports and Blender does not."""
    notes = []
    if facts.sideways:
        notes.append(
            f"{facts.sideways} photos are stored sideways and rotated by EXIF. Training rotates "
            f"them; Blender's camera backgrounds do not."
        )
    if facts.not_square:
        notes.append(
            f"{facts.not_square} cameras have pixels that are not square (fx and fy differ by up "
            f"to {facts.aspect:.1%}). Blender stores the pixel aspect per scene; choosing a camera "
            f"with the add-on sets it."
        )
    return notes

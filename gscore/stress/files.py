"""S33, S35, files: models written and read, and values of published formulas."""

import logging
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..io.ply.splats import read_ply, write_splats
from ..splats import PARAMETERS, Splats
from . import native
from .case import EmptyTestError, Measure, UnsupportedMachineError, case
from .compare import different_bits, require_covered
from .scenes import SplatScene, draw_scene

_GOLDEN = Path(__file__).parents[2] / "tests" / "raster" / "golden" / "gsplat_formulas.npz"


@case("S33", "a model through its file", on_device=True)
def round_trip(full: bool) -> Iterator[Measure]:
    """Oracle: the model that was written; the same without its broken rows."""
    for degree in range(4):
        scene = draw_scene(3300 + degree, count=300, sh_degree=degree, width=48, height=40)
        model = Splats(**{name: getattr(scene, name) for name in PARAMETERS})
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.ply"
            write_splats(path, model)
            back = read_ply(path)
            broken = scene.with_row(7, means=np.nan).with_row(9, sh0=np.inf)
            write_splats(path, Splats(**{name: getattr(broken, name) for name in PARAMETERS}))
            logging.getLogger("gscore.io.splat_rows").setLevel(logging.ERROR)
            try:
                filtered = read_ply(path)
            finally:
                logging.getLogger("gscore.io.splat_rows").setLevel(logging.NOTSET)
        before = {name: getattr(model, name) for name in PARAMETERS}
        changed = different_bits(before, {name: getattr(back, name) for name in PARAMETERS})
        yield Measure("numbers changed", float(changed), 0)
        again = replace(scene, **{name: getattr(back, name) for name in PARAMETERS})
        first, second = native.draw(scene), native.draw(again)
        require_covered(first.pictures["alpha"])
        error = max(np.abs(p - second.pictures[k]).max() for k, p in first.pictures.items())
        yield Measure("picture", float(error), 1e-6)
        finite = all(np.isfinite(getattr(filtered, name)).all() for name in PARAMETERS)
        left = abs(len(filtered) - 298) + (not finite)
        yield Measure("broken rows kept or good ones lost", float(left), 0)


@case("S35", "values of published formulas", on_device=True, needs=())
def golden(full: bool) -> Iterator[Measure]:
    """Oracle: gsplat's published formulas in plain numpy float64, stored with the tests."""
    if not _GOLDEN.is_file():
        raise UnsupportedMachineError(
            "the stored values are in the source, not in the installed package"
        )
    with np.load(_GOLDEN, allow_pickle=False) as stored:
        values = {name: stored[name] for name in stored}
    height, width = values["alpha"].shape
    scene = SplatScene(
        **{name: values[f"in_{name}"].astype(np.float32) for name in (*PARAMETERS, "viewmat", "K")},
        width=width,
        height=height,
    )
    background = tuple(values["in_background"].tolist())
    for suffix, antialias in (("", False), ("_antialiased", True)):
        drawn = native.draw(scene, antialias=antialias, background=background)
        require_covered(drawn.pictures["alpha"])
        for name, key in (("rgb", "image"), ("alpha", "alpha"), ("inverse_depth", "inverse_depth")):
            error = np.abs(drawn.pictures[name] - values[key + suffix]).max()
            yield Measure("picture", float(error), 1e-5)
        seen = drawn.projected["depths"] > 0
        if seen.sum() < 20:
            raise EmptyTestError("too few splats are visible")
        for name in ("means2d", "conics", "depths", "colors"):
            known = values[name][seen].reshape(int(seen.sum()), -1)
            error = np.abs(drawn.projected[name][seen].reshape(known.shape) - known).max(1)
            yield Measure(name, float((error / np.maximum(np.abs(known).max(1), 1e-3)).max()), 1e-5)
        # Half the longer side of the box where alpha is 1/255, from the stored conics.
        xx, xy, yy = values["conics"][seen].T
        det = xx * yy - xy * xy
        reach = 2 * np.log(255 * drawn.projected["opacities"][seen].astype(np.float64))
        radius = np.sqrt(np.maximum(reach, 0) * np.maximum(yy, xx) / det)
        yield Measure("radii, px", float(np.abs(drawn.radii[seen] - radius).max()), 1.0 + 1e-4)

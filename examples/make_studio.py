"""Make the example capture: a clothed figure rendered with Cycles, reconstructed with COLMAP.

python examples/make_studio.py -o examples/studio

Needs gscore and the Python packages bpy (4.5 or later), pycolmap (4 or later) and pillow. Seeds are
fixed: the scene is always the same; pictures and model may differ slightly between versions.
"""

import argparse
import logging
import time
from pathlib import Path

import bpy
import numpy as np
from studio_maker import blender, cameras, figure, render, sfm, stage, write

log = logging.getLogger("make_studio")


def main():
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write")
    parser.add_argument(
        "--size", type=int, nargs=2, default=(480, 640), metavar=("W", "H"), help="size in pixels"
    )
    parser.add_argument("--views", type=int, default=60, help="number of cameras, on three rings")
    parser.add_argument(
        "--samples", type=int, default=28, help="maximum samples per pixel, before denoising"
    )
    parser.add_argument("--threads", type=int, default=0, help="threads of Cycles; 0: one per core")
    parser.add_argument(
        "--surface", type=Path, metavar="FILE.ply", help="write the figure's triangles too, metres"
    )
    parser.add_argument(
        "--preview", action="store_true", help="coarse cloth, one picture of few samples, no COLMAP"
    )
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    width, height = args.size
    K = cameras.intrinsics(width, height)
    viewmats = cameras.around(args.views, np.random.default_rng(3))
    names = [f"view_{i:03d}" for i in range(args.views)]
    chosen = [args.views // 3] if args.preview else range(args.views)

    bpy.ops.wm.read_factory_settings(use_empty=True)
    log.info("Stage")
    stage.build(np.random.default_rng(1))
    log.info("Figure; the cloth simulation takes a few minutes")
    figure.build(np.random.default_rng(2), coarse=args.preview)
    if args.surface:
        write.surface(args.surface, *blender.figure_surface())
    camera = cameras.add_camera()
    render.configure(
        width, height, min(args.samples, 8) if args.preview else args.samples, args.threads
    )
    args.output.mkdir(parents=True, exist_ok=True)
    for i in chosen:
        start = time.perf_counter()
        cameras.place(camera, K, viewmats[i], width)
        write.view(args.output, names[i], *render.picture(args.output / ".render"))
        log.info("%s in %.1f s", names[i], time.perf_counter() - start)
    if args.preview:
        return
    centers = -np.einsum("cji,cj->ci", viewmats[:, :3, :3], viewmats[:, :3, 3])
    log.info("COLMAP")
    model = args.output / "sparse" / "0"
    numbers = sfm.reconstruct(args.output / "images", model, [f"{n}.jpg" for n in names], centers)
    write.truth(args.output, names, K, viewmats, width, height, numbers)
    log.info("COLMAP found %s", numbers)


if __name__ == "__main__":
    main()

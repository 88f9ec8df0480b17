"""Meshes against the true surface and silhouettes of held-out views; rows of docs/mesh.md.

python tools/measure/surface.py MESH.ply... --truth FIGURE.ply --cameras CAPTURE
python tools/measure/surface.py MESH.ply... --cameras CAPTURE
python tools/measure/surface.py MESH.ply... --silhouettes LEGO
python tools/measure/surface.py --poisson RUN --cameras CAPTURE  # needs pymeshlab

CAPTURE is made by examples/make_studio.py, FIGURE.ply in the same run with --surface; without it
the surface is that of the exact depths. Only what cameras see counts, so the body below the clothes
does not. LEGO has transforms_test.json, whose pictures have alpha. --poisson compares the surfaces
that screened Poisson reconstruction makes of the splats of a RUN, and of the points of its depths.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import KDTree

from gscore import read_splat_file
from gscore.io.mesh.files import TriangleMesh, read_mesh
from gscore.mesh.surface_view import pixel_rays, surface_view
from gscore.raster.api import render, splat_normals
from gscore.raster.mesh import mesh_depth
from gscore.splats import Splats

SAMPLES = 300_000
"""Points by which a mesh is compared."""
SPACING = 0.0015
"""Distance between points of the true surface, metres."""
TOLERANCE = 0.001
"""Depth behind the true surface at which a camera still sees a point, metres."""
DEPTH_STEPS = 65536 / 4
"""Value of the exact depths times depth in metres."""
OCTREE, TRIMMED = 10, 0.01
"""Depth of the octree of Poisson reconstruction, and largest distance of its surface from the
points, metres."""
SPREAD = 0.035
"""Largest difference of mean and median depth that `gscore mesh` fuses, metres."""
STEP = 0.03
"""Change of depth over two pixels beyond which they are on different surfaces, metres."""


def sampled(mesh: TriangleMesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """`count` points spread evenly over a mesh, [N, 3], and the unit normals of their triangles."""
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    double = np.linalg.norm(across, axis=1)
    rng = np.random.default_rng(0)
    rows = rng.choice(len(double), count, p=double / double.sum())
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    points = a[rows] + u * (b - a)[rows] + v * (c - a)[rows]
    return points, across[rows] / double[rows, None]


class Truth:
    """Points of the true surface that cameras see, with normals turned to them."""

    def __init__(self, points: np.ndarray, normals: np.ndarray, shown: np.ndarray) -> None:
        """`points`: [N, 3], with their unit normals; `shown`: [M, 3], a point per pixel, which is
        the visible surface, however fine its parts."""
        self.normals = normals
        self.shown = shown[np.random.default_rng(0).choice(len(shown), SAMPLES)]
        self.height = np.ptp(points[:, 2])
        self._near = KDTree(points)

    def row(self, mesh: TriangleMesh) -> str:
        """Columns: distances to and from the truth (mean, 95 %) in % of its height; normals."""
        points, normals = sampled(mesh, SAMPLES)
        there, rows = self._near.query(points, workers=-1)
        back = KDTree(points).query(self.shown, workers=-1)[0]
        cosine = (normals * self.normals[rows]).sum(axis=1)
        angle = np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1))))
        cells = [f"{100 * f(d) / self.height:.3f}" for d in (there, back) for f in (np.mean, _most)]
        return " | ".join([*cells, f"{angle:.1f}"])


def of_surface(surface: Path, capture: Path) -> Truth:
    """The truth by triangles, whose points are `SPACING` apart."""
    mesh = read_mesh(surface)
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    points, normals = sampled(mesh, round(area / SPACING**2))
    seen, shown = np.zeros(len(points), bool), []
    for _, K, viewmat, width, height in views_of(capture):
        inverse = mesh_depth(mesh.vertices, mesh.triangles, K, viewmat, width, height)
        rows = np.flatnonzero(~seen)
        at = points[rows] @ viewmat[:3, :3].T + viewmat[:3, 3]
        pixel = np.floor(at @ K.T / at[:, 2:])[:, :2].astype(int)
        inside = ((pixel >= 0) & (pixel < [width, height])).all(axis=1) & (at[:, 2] > 0)
        rows, at, pixel = rows[inside], at[inside], pixel[inside]
        depth = inverse[pixel[:, 1], pixel[:, 0]]
        towards = -((normals[rows] @ viewmat[:3, :3].T) * at).sum(axis=1)
        slant = np.abs(towards) / np.linalg.norm(at, axis=1)
        # A pixel's depth is that of its centre: half a pixel aside, a slanted surface differs.
        slack = TOLERANCE + at[:, 2] / K[0, 0] / np.maximum(slant, 0.1)
        near = (depth > 0) & (np.abs(at[:, 2] * depth - 1) < slack * depth) & (slant > 0.1)
        seen[rows[near]] = True
        normals[rows[near]] *= np.sign(towards[near])[:, None]
        v, u = np.nonzero(inverse)
        rays = np.stack([u + 0.5, v + 0.5, np.ones(len(u))], axis=1) @ np.linalg.inv(K).T
        shown.append((rays / inverse[v, u, None] - viewmat[:3, 3]) @ viewmat[:3, :3])
    return Truth(points[seen], normals[seen], np.concatenate(shown))


def of_depths(capture: Path) -> Truth:
    """The truth by the exact depths inside the masks; normals from neighbouring pixels, and none
    where these are on different surfaces."""
    points, normals = [], []
    for name, K, viewmat, width, height in views_of(capture):
        code = np.asarray(Image.open(capture / "depths" / f"{name}.png", formats=["PNG"])).astype(
            np.float64
        )
        mask = np.asarray(Image.open(capture / "masks" / f"{name}.png", formats=["PNG"]))
        depth = np.divide(DEPTH_STEPS, code, out=np.zeros_like(code), where=code > 0)
        places = depth[..., None] * pixel_rays(K, height, width)
        across = places[1:-1, 2:] - places[1:-1, :-2]
        down = places[2:, 1:-1] - places[:-2, 1:-1]
        normal = np.cross(down, across)
        length = np.linalg.norm(normal, axis=-1)
        flat = np.maximum(np.abs(across[..., 2]), np.abs(down[..., 2])) < STEP
        good = (mask[1:-1, 1:-1] > 250) & (code[1:-1, 1:-1] > 0) & flat & (length > 0)
        points.append((places[1:-1, 1:-1][good] - viewmat[:3, 3]) @ viewmat[:3, :3])
        normals.append(normal[good] / length[good, None] @ viewmat[:3, :3])
    every = np.concatenate(points)
    return Truth(every, np.concatenate(normals), every)


def views_of(capture: Path) -> Iterator[tuple[str, np.ndarray, np.ndarray, int, int]]:
    """Name, K, viewmat, width and height of the true cameras whose picture there is."""
    found = json.loads((capture / "cameras_true.json").read_text())
    for view in found["views"]:
        if (capture / "images" / view["name"]).exists():
            size = found["width"], found["height"]
            yield Path(view["name"]).stem, np.array(found["K"]), np.array(view["viewmat"]), *size


def poisson_points(splats: Splats, capture: Path) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Name, points [N, 3] and unit normals of the solid splats, turned to the camera that faces
    them most of those that see them, and of every second pixel of the depths that `gscore mesh`
    fuses."""
    solid = splats.subset(np.flatnonzero(splats.opacities > 0))
    best, normals = np.full(len(solid), -1.0), np.zeros((len(solid), 3))
    points, facing = [], []
    for _, K, viewmat, width, height in views_of(capture):
        drawn = render(splats, K, viewmat, width, height, depths=True, normals=True)
        turned = splat_normals(solid.means, solid.quats, solid.scales, viewmat)
        at = solid.means @ viewmat[:3, :3].T + viewmat[:3, 3]
        ahead = np.maximum(at[:, 2:], 1e-6)
        u, v = np.floor((at @ K.T / ahead)[:, :2].T)
        seen = (at[:, 2] > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        rows, columns = np.where(seen, v, 0).astype(int), np.where(seen, u, 0).astype(int)
        seen &= at[:, 2] < drawn.median_depth[rows, columns] + SPREAD
        cosine = -(turned * at).sum(axis=1) / np.linalg.norm(at, axis=1)
        better = seen & (cosine > best)
        best[better], normals[better] = cosine[better], (turned @ viewmat[:3, :3])[better]
        view = surface_view(drawn, K, viewmat, spread=SPREAD, far=np.inf)
        fused = (view.weight > 0) & np.isfinite(view.depth)
        fused[1::2] = fused[:, 1::2] = False
        places = pixel_rays(K, height, width)[fused] * view.depth[fused, None]
        points.append((places - viewmat[:3, 3]) @ viewmat[:3, :3])
        facing.append(view.planes[fused, :3] @ viewmat[:3, :3])
    shown = best > 0
    yield "Poisson, splats", solid.means[shown].astype(np.float64), normals[shown]
    yield "Poisson, points of depths", np.concatenate(points), np.concatenate(facing)


def poisson(points: np.ndarray, normals: np.ndarray) -> TriangleMesh:
    """Screened Poisson reconstruction (Kazhdan and Hoppe 2013), cut `TRIMMED` from the points."""
    try:
        import pymeshlab as meshes
    except ImportError as error:
        raise SystemExit("--poisson needs pymeshlab: pip install pymeshlab") from error
    made = meshes.MeshSet()
    made.add_mesh(meshes.Mesh(vertex_matrix=points, v_normals_matrix=normals))
    made.generate_surface_reconstruction_screened_poisson(depth=OCTREE)
    found = made.current_mesh()
    vertices, triangles = found.vertex_matrix(), found.face_matrix()
    near = KDTree(points).query(vertices, workers=-1)[0] < TRIMMED
    return TriangleMesh(vertices=vertices, triangles=triangles[near[triangles].all(axis=1)])


def _most(distances: np.ndarray) -> float:
    return float(np.quantile(distances, 0.95))


def overlap(mesh: TriangleMesh, scene: Path, every: int) -> str:
    """Columns: mean and lowest intersection over union of silhouettes in `every`-th test view."""
    found, shares = json.loads((scene / "transforms_test.json").read_text()), []
    for frame in found["frames"][::every]:
        picture = scene / frame["file_path"]
        alpha = np.asarray(Image.open(picture.with_suffix(".png"), formats=["PNG"]))[..., 3] >= 128
        height, width = alpha.shape
        focal = width / (2 * np.tan(found["camera_angle_x"] / 2))
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        viewmat = np.linalg.inv(np.array(frame["transform_matrix"]) @ np.diag([1, -1, -1, 1]))
        drawn = mesh_depth(mesh.vertices, mesh.triangles, K, viewmat, width, height) > 0
        shares.append((alpha & drawn).sum() / (alpha | drawn).sum())
    return f"{np.mean(shares):.4f} | {np.min(shares):.4f}"


def main() -> int:
    """Print a row per mesh."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", type=Path, nargs="*")
    parser.add_argument("--poisson", type=Path, metavar="RUN", help="with --cameras")
    parser.add_argument("--truth", type=Path, metavar="FILE.ply")
    parser.add_argument("--cameras", type=Path, metavar="CAPTURE")
    parser.add_argument("--silhouettes", type=Path, metavar="FOLDER")
    parser.add_argument("--every", type=int, default=4, help="use every n-th test view")
    args = parser.parse_args()
    if not args.cameras and (args.poisson or not args.silhouettes):
        parser.error("give --cameras, or --silhouettes for meshes alone")
    if args.cameras:
        truth = of_surface(args.truth, args.cameras) if args.truth else of_depths(args.cameras)
        print("| mesh | triangles | to truth, % | 95 % | from truth, % | 95 % | normals, deg |")
        print("|---|---|---|---|---|---|---|", flush=True)
    else:
        print("| mesh | triangles | IoU | lowest |\n|---|---|---|---|", flush=True)
    if args.poisson:
        splats = read_splat_file(args.poisson / "point_cloud.ply").splats
        for name, points, normals in poisson_points(splats, args.cameras):
            mesh = poisson(points, normals)
            print(f"| {name} | {len(mesh):,} | {truth.row(mesh)} |", flush=True)
    for path in args.meshes:
        mesh = read_mesh(path)
        row = truth.row(mesh) if args.cameras else overlap(mesh, args.silhouettes, args.every)
        print(f"| {path.stem} | {len(mesh):,} | {row} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

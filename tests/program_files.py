"""Captures as other photogrammetry programs write them, by formulas of their own documents.

Nothing here uses gscore: angles are scipy's, files are written as text. `pixels_of` holds each
program's projection as its manual prints it.
"""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

_NED = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
"""East, north, up to north, east, down."""
_MOUNT = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
"""Columns: the camera's x, y up, z backwards in the body's nose, right wing, down (figure 12a)."""
_UPWARDS = np.diag([1.0, -1, -1])
"""From a camera with y down and z forwards to one with y up and z backwards."""


@dataclass(frozen=True)
class Rig:
    """What is known of a capture; poses in any world, lengths of the lens in pixels."""

    names: tuple[str, ...]
    turns: np.ndarray
    """[N, 3, 3], world to camera, y down, z forwards."""
    places: np.ndarray
    """[N, 3], camera centres."""
    size: tuple[int, int]
    focal: float
    off: tuple[float, float] = (0.0, 0.0)
    """Principal point from the middle of the picture, x right, y down."""
    terms: dict[str, float] = field(default_factory=dict)
    """Coefficients of the lens by the program's own names."""

    def seen(self, points: np.ndarray) -> np.ndarray:
        """[N, P, 2]: x / z and y / z of world points [P, 3]."""
        at = np.einsum("nij,npj->npi", self.turns, points[None] - self.places[:, None])
        return at[..., :2] / at[..., 2:]


def _of(rig: Rig, *names: str) -> list[float]:
    return [rig.terms.get(name, 0.0) for name in names]


def _line(values: object) -> str:
    return " ".join(repr(float(v)) for v in np.ravel(np.asarray(values, np.float64)))


def write_rs_csv(folder: Path, rig: Rig, *, new: bool = True) -> Path:
    """Internal/External Camera Parameters, of RealityScan 2.2 or with the older names."""
    from scipy.spatial.transform import Rotation  # Blender's Python lacks it

    head = "yaw,pitch,roll,f_35mm,px_norm,py_norm" if new else "heading,pitch,roll,f,px,py"
    lines = [f"#name,x,y,alt,{head},k1,k2,k3,k4,t1,t2"]
    if not new:
        lines.insert(0, f"#cameras {len(rig.names)}")
    longer = max(rig.size)
    for name, turn, place in zip(rig.names, rig.turns, rig.places, strict=True):
        body = _NED @ turn.T @ _UPWARDS @ _MOUNT.T  # from the body's axes to north, east, down
        angles = Rotation.from_matrix(body).as_euler("ZYX", degrees=True)
        lens = [rig.focal / longer * 36, rig.off[0] / longer, rig.off[1] / longer]
        lens += _of(rig, "k1", "k2", "k3", "k4", "t1", "t2")
        lines.append(",".join([name, *(repr(float(v)) for v in (*place, *angles, *lens))]))
    path = folder / "registration.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def write_rs_opencv_csv(folder: Path, rig: Rig) -> Path:
    """The same, OpenCV-compliant."""
    names = ["#name", "tx", "ty", "tz", *(f"R{i}{j}" for i in range(3) for j in range(3))]
    names += ["f_pix", "px_pix", "py_pix", "k1", "k2", "t2", "t1", "k3", "k4"]
    lines = [",".join(names) + " (R = [Rij] provided in row major ordering and t = (tx,ty,tz))"]
    middle = [rig.size[0] / 2 + rig.off[0], rig.size[1] / 2 + rig.off[1]]
    for name, turn, place in zip(rig.names, rig.turns, rig.places, strict=True):
        values = [*(-turn @ place), *turn.ravel(), rig.focal, *middle]
        values += _of(rig, "k1", "k2", "t2", "t1", "k3", "k4")
        lines.append(",".join([name, *(repr(float(v)) for v in values)]))
    path = folder / "opencv.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def write_rs_xmp(photos: Path, rig: Rig, *, attributes: bool = False, **other: str) -> None:
    """An XMP file for each photo; with rotation and coefficients as attributes, as older ones."""
    longer = max(rig.size)
    for name, turn, place in zip(rig.names, rig.turns, rig.places, strict=True):
        stated = {"Version": "4", "PosePrior": "initial", "Coordinates": "absolute",
                  "DistortionModel": "brown3t2", "FocalLength35mm": repr(36 * rig.focal / longer),
                  "Skew": "0", "AspectRatio": "1", "PrincipalPointU": repr(rig.off[0] / longer),
                  "PrincipalPointV": repr(rig.off[1] / longer), "CalibrationPrior": "initial",
                  **other}  # fmt: skip
        lens = _line(_of(rig, "k1", "k2", "k3", "k4", "t1", "t2"))
        inner = {"Rotation": _line(turn), "Position": _line(place), "DistortionCoeficients": lens}
        if attributes:
            stated |= {key: inner.pop(key) for key in ("Rotation", "DistortionCoeficients")}
        rows = [f'xcr:{key}="{value}"' for key, value in stated.items()]
        rows += ['xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#">']
        rows += [f"<xcr:{key}>{value}</xcr:{key}>" for key, value in inner.items()]
        text = '<x:xmpmeta xmlns:x="adobe:ns:meta/">\n<rdf:RDF xmlns:rdf='
        text += '"http://www.w3.org/1999/02/22-rdf-syntax-ns#">\n<rdf:Description '
        text += "\n".join(rows) + "\n</rdf:Description>\n</rdf:RDF>\n</x:xmpmeta>\n"
        path = (photos / name).with_suffix(".xmp")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


@dataclass(frozen=True)
class Chunk:
    """Where Metashape's own axes lie in the world, and how its file is laid out."""

    turn: np.ndarray = field(default_factory=lambda: np.eye(3))
    shift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    scale: float = 1.0
    where: str = "component"
    """`component`, `chunk` or empty: neither has a transform."""
    kind: str = "frame"
    endings: bool = True
    """Whether labels have the photo's ending."""


def write_metashape(folder: Path, rig: Rig, chunk: Chunk | None = None) -> Path:
    """Export Cameras, Agisoft XML; the second half of the cameras in a group, one not aligned."""
    chunk = chunk or Chunk()
    width, height = rig.size
    place = "<transform>\n" + "".join(
        f'<{tag} locked="true">{_line(value)}</{tag}>\n'
        for tag, value in (("rotation", chunk.turn), ("translation", chunk.shift),
                           ("scale", chunk.scale))
    ) + "</transform>\n"  # fmt: skip
    terms = {"f": rig.focal, "cx": rig.off[0], "cy": rig.off[1], **rig.terms}
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0">',
        '<chunk label="Chunk 1" enabled="true">\n<sensors next_id="1">',
        f'<sensor id="0" label="lens" type="{chunk.kind}">',
        f'<resolution width="{width}" height="{height}"/>',
        f'<calibration type="{chunk.kind}" class="initial"><f>1</f></calibration>',
        f'<calibration type="{chunk.kind}" class="adjusted">',
        f'<resolution width="{width}" height="{height}"/>',
        *(f"<{name}>{float(value)!r}</{name}>" for name, value in terms.items()),
        '</calibration>\n</sensor>\n</sensors>\n<components next_id="1" active_id="0">',
        '<component id="0" label="Component 1">',
        place if chunk.where == "component" else "",
        '</component>\n</components>\n<cameras next_id="99" next_group_id="1">',
    ]
    half = len(rig.names) // 2
    for i, (name, turn, center) in enumerate(zip(rig.names, rig.turns, rig.places, strict=True)):
        if i == half:
            lines.append('<group id="0" label="Group 1" type="folder">')
        own = np.eye(4)
        own[:3, :3] = chunk.turn.T @ turn.T
        own[:3, 3] = chunk.turn.T @ (center - chunk.shift) / chunk.scale
        label = name if chunk.endings else name.rpartition(".")[0]
        lines.append(
            f'<camera id="{i}" sensor_id="0" component_id="0" label="{label}">'
            f"<transform>{_line(own)}</transform><orientation>1</orientation></camera>"
        )
    lines += ["</group>", '<camera id="98" sensor_id="0" label="lost"></camera>', "</cameras>"]
    lines += [place if chunk.where == "chunk" else "", "</chunk>\n</document>\n"]
    path = folder / "cameras.xml"
    path.write_text("\n".join(lines))
    return path


def write_opensfm(
    folder: Path,
    rig: Rig,
    kind: str = "brown",
    points: np.ndarray | None = None,
    colors: np.ndarray | None = None,
) -> Path:
    """reconstruction.json, with a smaller second part that could not be joined."""
    from scipy.spatial.transform import Rotation

    longer = max(rig.size)
    lens = {"projection_type": kind, "width": rig.size[0], "height": rig.size[1], **rig.terms}
    if kind in ("perspective", "fisheye"):
        lens["focal"] = rig.focal / longer
    else:
        lens |= {"focal_x": rig.focal / longer, "focal_y": 1.01 * rig.focal / longer}
        lens |= {"c_x": rig.off[0] / longer, "c_y": rig.off[1] / longer}
    shots = {
        name: {
            "camera": "v2 lens",
            "rotation": Rotation.from_matrix(turn).as_rotvec().tolist(),
            "translation": (-turn @ place).tolist(),
            "orientation": 1,
        }
        for name, turn, place in zip(rig.names, rig.turns, rig.places, strict=True)
    }
    points = np.zeros((0, 3)) if points is None else points
    colors = np.tile([10.0, 20.0, 30.0], (len(points), 1)) if colors is None else colors
    stated = {
        str(i): {"coordinates": row.tolist(), "color": color.tolist()}
        for i, (row, color) in enumerate(zip(points, colors, strict=True))
    }
    part = {"cameras": {"v2 lens": lens}, "shots": shots, "points": stated}
    rest = {"cameras": {"v2 lens": lens}, "shots": dict([next(iter(shots.items()))])}
    path = folder / "reconstruction.json"
    path.write_text(json.dumps([rest, part]))
    return path


def write_llff(folder: Path, rig: Rig) -> Path:
    """poses_bounds.npy, columns as LLFF's own script orders them."""
    rows = []
    for i in np.argsort(rig.names):
        right, down, forwards = rig.turns[i]
        lens = [rig.size[1], rig.size[0], rig.focal]
        rows.append([*np.column_stack([down, right, -forwards, rig.places[i], lens]).ravel(), 1, 9])
    np.save(folder / "poses_bounds.npy", np.array(rows, np.float64))
    return folder / "poses_bounds.npy"


def _bent(xy: np.ndarray, radial: list[float], aside: float, down: float) -> np.ndarray:
    """Brown's lens: `aside` goes with (r^2 + 2 x^2) in x, `down` with (r^2 + 2 y^2) in y."""
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    factor = 1 + sum(k * r2 ** (i + 1) for i, k in enumerate(radial))
    across = x * factor + aside * (r2 + 2 * x * x) + 2 * down * x * y
    return np.stack([across, y * factor + down * (r2 + 2 * y * y) + 2 * aside * x * y], axis=-1)


def _equidistant(xy: np.ndarray) -> np.ndarray:
    radius = np.linalg.norm(xy, axis=-1, keepdims=True)
    return xy * np.arctan(radius) / radius


def pixels_of(program: str, rig: Rig, points: np.ndarray) -> np.ndarray:
    """[N, P, 2] pixels of world points, corners of the picture at 0, as the program has them."""
    xy = rig.seen(points)
    middle = np.array(rig.size) / 2 + rig.off
    k = _of(rig, "k1", "k2", "k3", "k4")
    if program == "realityscan":  # (42) to (48)
        return rig.focal * _bent(xy, k, *_of(rig, "t1", "t2")) + middle
    if program in ("frame", "fisheye"):  # Metashape
        bent = _bent(_equidistant(xy) if program == "fisheye" else xy, k, *_of(rig, "p1", "p2"))
        b1, b2 = _of(rig, "b1", "b2")
        u = bent[..., 0] * (rig.focal + b1) + bent[..., 1] * b2
        return np.stack([u, bent[..., 1] * rig.focal], axis=-1) + middle
    if program in ("opensfm brown", "opensfm radial"):
        bent = _bent(xy, k[:3], *_of(rig, "p2", "p1"))
        return bent * rig.focal * [1, 1.01] + middle
    if program == "opensfm perspective":
        return rig.focal * _bent(xy, k[:2], 0, 0) + np.array(rig.size) / 2
    angles = _equidistant(xy)
    return (
        rig.focal * _bent(angles, k[:2], 0, 0) + np.array(rig.size) / 2
        if program == "opensfm fisheye"
        else rig.focal * _bent(angles, k, 0, 0) * [1, 1.01] + middle
    )


def pinhole(rig: Rig) -> Rig:
    """The same without a bent lens."""
    return replace(rig, terms={})

"""Every readable format: a valid file of each, its reader, and a check of good results."""

import gzip
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gscore.config import DataConfig, TrainConfig
from gscore.config_file import config_json, load_config
from gscore.control import Control
from gscore.datasets.pku.cams import read_cam
from gscore.datasets.pku.case import _projections
from gscore.datasets.read import read_capture
from gscore.datasets.transforms_json import read_transforms
from gscore.depth.maps import read_map
from gscore.depth.params import read_params
from gscore.events import Event, Progress, from_line, to_line
from gscore.formats import read_splat_file, write_splat_file
from gscore.io.cameras_json import WORLD_FILE, read_cameras_json, read_up, write_cameras, write_up
from gscore.io.colmap.folder import read_model, write_model
from gscore.io.colmap.model import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
from gscore.io.images.png import write_png
from gscore.io.images.read_image import read_image, read_info, read_mask
from gscore.io.mesh.files import read_mesh, write_mesh
from gscore.io.ply.points import read_point_cloud
from gscore.io.ply.splats import read_ply, write_splats
from gscore.io.runs import read_run
from gscore.io.sequences import read_sequence
from gscore.scene import Cameras
from gscore.splats import Splats
from gscore.stress.capture import toy_photos
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.files import checkpoint
from gscore.trainer.files.run_folder import RunFolder
from gscore.trainer.model.training_frame import TrainingFrame
from gscore.trainer.prepare import Prepared
from gscore.trainer.session import Session
from gscore.trainer.trainer import Trainer
from tests import program_files
from tests.checkpoint_files import checkpoint_json, with_checkpoint_json
from tests.formats.test_layouts import ksplat_bytes


@dataclass(frozen=True)
class Format:
    """A kind of file."""

    name: str
    file: str
    """Its path in a folder; the target of the damage."""
    write: Callable[[Path], Any]
    """Makes a valid folder."""
    read: Callable[[Path], Any]
    """Reads the folder; raises GsError or checks its result."""
    structured: bool = False
    """JSON, whose values are damaged too."""
    json_in: Callable[[bytes], bytes] = lambda raw: raw
    """The JSON in the file."""
    put_json: Callable[[bytes, bytes], bytes] = lambda raw, text: text
    """The file with other JSON in it, its checksum right."""


def _model() -> ColmapModel:
    rng = np.random.default_rng(1)
    camera = ColmapCamera(
        model="OPENCV", width=64, height=48, params=np.array([60, 61, 32, 24, 0.1, 0, 0, 0.0])
    )
    ids = np.arange(5, dtype=np.int64) + 3
    images = [
        ColmapImage(
            id=i + 1,
            name=f"view_{i}.png",
            camera_id=1,
            qvec=np.array([1.0, 0, 0, 0]),
            tvec=rng.normal(size=3),
            xys=rng.uniform(0, 48, (5, 2)),
            point3D_ids=ids,
        )
        for i in range(3)
    ]
    points = ColmapPoints(
        ids=ids,
        xyz=rng.normal(size=(5, 3)),
        rgb=rng.integers(0, 255, (5, 3)).astype(np.uint8),
        error=np.full(5, 0.5),
        track_lengths=np.full(5, 3, np.int32),
    )
    return ColmapModel(cameras={1: camera}, images=images, points=points)


def _read_model(root: Path) -> None:
    model = read_model(root)
    for image in model.images:
        assert ".." not in image.name and not Path(image.name).is_absolute()
        assert np.isfinite(image.viewmat).all()
        assert image.camera_id in model.cameras


def _splats(count: int = 4, rest: int = 3) -> Splats:
    rng = np.random.default_rng(2)
    f = lambda *shape: rng.normal(size=shape).astype(np.float32)  # noqa: E731
    return Splats(
        means=f(count, 3),
        quats=f(count, 4),
        scales=f(count, 3),
        opacities=f(count),
        sh0=f(count, 1, 3),
        shN=f(count, rest, 3),
    )


def _read_splats(root: Path) -> None:
    splats = read_ply(root / "a.ply")
    for array in vars(splats).values():
        assert np.isfinite(array).all()


def _write_compressed(root: Path) -> None:
    ends = [
        f"{end}_{what}{axis}" for what in ("", "scale_") for end in ("min", "max") for axis in "xyz"
    ]
    ends += [f"{end}_{axis}" for end in ("min", "max") for axis in "rgb"]
    packed = [f"packed_{what}" for what in ("position", "rotation", "scale", "color")]
    header = ["ply", "format binary_little_endian 1.0", "element chunk 1"]
    header += [f"property float {name}" for name in ends]
    header += ["element vertex 4", *(f"property uint {name}" for name in packed)]
    header += ["element sh 4", *(f"property uchar f_rest_{k}" for k in range(9)), "end_header\n"]
    rng = np.random.default_rng(3)
    body = rng.normal(size=len(ends)).astype("<f4").tobytes()
    body += rng.integers(0, 2**32, (4, 4)).astype("<u4").tobytes()
    body += rng.integers(0, 255, (4, 9)).astype(np.uint8).tobytes()
    (root / "a.ply").write_bytes("\n".join(header).encode() + body)


def _write_ascii_ply(root: Path) -> None:
    splats = _splats(3, 0)
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    columns = np.concatenate(
        [splats.means, splats.sh0[:, 0], splats.opacities[:, None], splats.scales, splats.quats], 1
    )
    lines = ["ply", "format ascii 1.0", "element vertex 3"]
    lines += [f"property float {name}" for name in names] + ["end_header"]
    lines += [" ".join(f"{v:.5f}" for v in row) for row in columns]
    (root / "a.ply").write_text("\n".join(lines) + "\n")


def _read_points(root: Path) -> None:
    cloud = read_point_cloud(root / "a.ply")
    assert cloud.points.shape == cloud.colors.shape


def _write_points(root: Path) -> None:
    header = "ply\nformat binary_big_endian 1.0\nelement vertex 3\n"
    header += "".join(f"property double {a}\n" for a in "xyz")
    header += "".join(f"property uchar {a}\n" for a in ("red", "green", "blue"))
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    kind = np.dtype([("xyz", ">f8", 3), ("rgb", "u1", 3)])
    body = np.zeros(3, kind).tobytes() + b"\x03" + np.arange(3, dtype=">i4").tobytes()
    (root / "a.ply").write_bytes(header.encode() + body)


def _picture(seed: int = 5) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (12, 16, 3)).astype(np.uint8)


def _write_picture(ending: str, mode: str = "RGB") -> Callable[[Path], Any]:
    def write(root: Path) -> None:
        Image.fromarray(_picture()).convert(mode).save(root / f"a{ending}")

    return write


def _write_numbers(ending: str, values: np.ndarray) -> Callable[[Path], Any]:
    def write(root: Path) -> None:
        Image.fromarray(values).save(root / f"a{ending}")

    return write


_RAMP = np.arange(192, dtype=np.float32).reshape(12, 16) / 191


def _write_restarting_jpeg(root: Path) -> None:
    """With restart markers, and with grey below, so that its blocks are counted."""
    picture = _picture()
    picture[6:] = 128
    Image.fromarray(picture).save(root / "a.jpg", restart_marker_blocks=1)


def _read_picture(ending: str) -> Callable[[Path], Any]:
    def read(root: Path) -> None:
        path = root / f"a{ending}"
        info = read_info(path)
        assert info.width > 0 and info.height > 0
        image = read_image(path, upright=True)
        assert image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] in (3, 4)
        assert read_mask(path).dtype == np.uint8

    return read


def _write_transforms(root: Path) -> None:
    pose = np.eye(4)
    pose[2, 3] = 3
    frames = [
        {"file_path": f"images/{i}.png", "transform_matrix": pose.tolist(), "mask_path": "m.png"}
        for i in range(3)
    ]
    content = {"w": 64, "h": 48, "fl_x": 60.0, "fl_y": 60.0, "cx": 32, "cy": 24, "k1": 0.1}
    content |= {"camera_model": "OPENCV", "frames": frames, "ply_file_path": "a.ply"}
    content |= {"test_filenames": ["images/1.png"], "aabb_scale": 4}
    (root / "transforms.json").write_text(json.dumps(content))
    for i in range(3):
        write_png(root / f"images/{i}.png", _picture(i))
    _write_points(root)


def _read_transforms(root: Path) -> None:
    capture = read_transforms(DataConfig(source=root))
    for view in capture.views:
        assert root.resolve() in view.image.resolve().parents
        assert view.mask is None or root.resolve() in view.mask.resolve().parents
        assert np.isfinite(view.viewmat).all()
        assert np.isfinite(view.camera.params).all()


def _write_cameras(root: Path) -> None:
    K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    write_cameras(
        root / "cameras.json",
        Cameras(
            viewmats=np.tile(np.eye(4), (2, 1, 1)),
            Ks=np.tile(K, (2, 1, 1)),
            widths=np.array([64, 64]),
            heights=np.array([48, 48]),
            names=("a.png", "b.png"),
            up=np.array([0.0, 0, 1]),
        ),
    )


def _read_cameras(root: Path) -> None:
    cameras = read_cameras_json(root / "cameras.json")
    assert np.isfinite(cameras.viewmats).all() and np.isfinite(cameras.Ks).all()


def _write_params(root: Path) -> None:
    entry = {"scale": 0.5, "offset": 0.1, "accepted": True, "kind": "inverse"}
    (root / "depth_params.json").write_text(json.dumps({"a": entry, "b": entry}))


def _write_config(root: Path) -> None:
    (root / "config.json").write_text(config_json(DataConfig(source=root), TrainConfig()))


def _read_config(root: Path) -> None:
    assert read_run(root) is not None  # never raises: it reads the results of others
    load_config(root / "config.json")


def _write_sequence(root: Path) -> None:
    frame = {"frame": 3, "folder": "frame_000003", "psnr": 20.5, "steps": 100}
    content = {"gscore": "0", "options": {"frames": [3, 4]}, "frames": [frame], "mean": {"psnr": 1}}
    (root / "sequence.json").write_text(json.dumps(content))


def _read_sequence(root: Path) -> None:
    index = read_sequence(root)
    for entry in index.frames if index else ():
        place = (root / entry["folder"]).resolve()
        assert root.resolve() in place.parents


def _write_event(root: Path) -> None:
    event = Progress(
        step=1,
        iterations=9,
        loss=0.1,
        psnr=20.0,
        splats=5,
        steps_per_s=2.0,
        eta_s=4.0,
        elapsed_s=0.5,
        phase="growing",
    )
    (root / "events.jsonl").write_text(to_line(event))


def _read_event(root: Path) -> None:
    line = (root / "events.jsonl").read_bytes().decode("utf-8", "replace")
    found = from_line(line)
    assert found is None or isinstance(found, Event)


def _write_depth_png(root: Path) -> None:
    values = np.random.default_rng(6).integers(0, 65535, (12, 16)).astype(np.uint16)
    write_png(root / "a.png", values)


def _write_npy(root: Path) -> None:
    np.save(root / "a.npy", np.random.default_rng(6).random((12, 16)).astype(np.float32))


def _write_exr(root: Path) -> None:
    import OpenEXR

    values = np.random.default_rng(6).random((12, 16)).astype(np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"Z": values}) as file:
        file.write(str(root / "a.exr"))


def _write_tiff(root: Path) -> None:
    Image.fromarray(np.random.default_rng(6).random((12, 16)).astype(np.float32)).save(
        root / "a.tif"
    )


def _read_depth(name: str) -> Callable[[Path], Any]:
    def read(root: Path) -> None:
        values = read_map(root / name)
        assert values.dtype == np.float32 and values.ndim == 2
        assert not np.isinf(values).any()

    return read


def _write_program(write: Callable[[Path, program_files.Rig], Any]) -> Callable[[Path], None]:
    """Three photos and the camera file of another program."""

    def make(root: Path) -> None:
        turns, names = np.stack([np.eye(3)] * 3), tuple(f"{i}.png" for i in range(3))
        for name in names:
            write_png(root / name, np.zeros((6, 8, 3), np.uint8))
        terms = {"k1": 0.01, "k2": 0.002, "p1": 0.001}
        rig = program_files.Rig(names, turns, np.eye(3), (8, 6), 9.0, terms=terms)
        write(root, rig)

    return make


def _read_program(root: Path) -> None:
    for view in read_capture(DataConfig(source=root)).views:
        assert np.isfinite(view.viewmat).all() and np.isfinite(view.camera.params).all()
        assert view.image.is_relative_to(root)


def _write_npz(root: Path) -> None:
    np.savez(root / "cameras_sphere.npz", world_mat_0=np.eye(4), world_mat_1=np.eye(4))


def _write_cam(root: Path) -> None:
    rows = "\n".join(" ".join(str(v) for v in row) for row in np.eye(4))
    (root / "0_cam.txt").write_text(
        f"extrinsic\n{rows}\n\nintrinsic\n60 0 32\n0 60 24\n0 0 1\n\n1 2\n"
    )


_TRAIN = TrainConfig(iterations=20, max_splats=60, sh_degree=1)
_PHOTOS = toy_photos()


def _session(trainer: Trainer, root: Path) -> Session:
    return Session(
        Prepared(trainer=trainer),
        RunFolder(root),
        DataConfig(source=root),
        emit=lambda event: None,
        control=Control(),
        lpips=None,
        lpips_reason="",
    )


def _write_checkpoint(root: Path) -> None:
    trainer = Trainer(_TRAIN, Analysis(photos=_PHOTOS))
    session = _session(trainer, root)
    for _ in range(2):
        trainer.step()
    path = session._write_checkpoint()
    path.replace(root / "a.safetensors")


def _read_checkpoint(root: Path) -> None:
    """As a resume of `train` does, for one step."""
    found = checkpoint.load(root / "a.safetensors")
    checkpoint.check_compatible(found, _TRAIN, _PHOTOS)
    with checkpoint.checkpoint_errors(found.path):
        frame = TrainingFrame.from_dict(found.trainer["frame"])
    trainer = Trainer(_TRAIN, Analysis(photos=_PHOTOS, frame=frame))
    checkpoint.check_same_inputs(found, trainer)
    session = _session(trainer, root)
    with checkpoint.checkpoint_errors(found.path):
        trainer.restore(found.trainer, found.tensors)
        session.restore(found.session)
    trainer.step()
    session._start_watchdog()
    session._checkpoint(keep=1)


def _colmap(name: str, binary: bool) -> Format:
    ending = "bin" if binary else "txt"
    return Format(
        f"colmap_{name}_{ending}",
        f"{name}.{ending}",
        lambda root: write_model(_model(), root, binary=binary),
        _read_model,
    )


def _write_mesh_ply(root: Path) -> None:
    rng = np.random.default_rng(3)
    write_mesh(root / "a.ply", rng.normal(size=(6, 3)), rng.integers(0, 6, (5, 3)))


def _write_mesh_obj(root: Path) -> None:
    (root / "a.obj").write_text(
        "o one\nv 0 0 0\nv 1 0.5 0\nv 1 1 -2e-1\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1 4//1\n"
        "f -1 1 2\n"
    )


def _read_mesh(name: str) -> Callable[[Path], None]:
    def read(root: Path) -> None:
        mesh = read_mesh(root / name)
        assert len(mesh) and mesh.triangles.min() >= 0
        assert mesh.triangles.max() < len(mesh.vertices)
        assert np.isfinite(mesh.vertices).all()

    return read


def _plain_ply(root: Path) -> None:
    write_splats(root / "a.ply", _splats())


def _write_model(name: str, **options: Any) -> Callable[[Path], Any]:
    """A model of three splats in the format of its ending."""
    return lambda root: write_splat_file(root / name, _splats(3), **options)


def _read_model(name: str) -> Callable[[Path], Any]:
    def read(root: Path) -> None:
        for array in vars(read_splat_file(root / name).splats).values():
            assert np.isfinite(array).all()

    return read


def _model_format(
    key: str, name: str, file: str = "", *, structured: bool = False, **options: Any
) -> Format:
    return Format(key, file or name, _write_model(name, **options), _read_model(name), structured)


def _glb_json(key: str, name: str) -> Format:
    whole = _model_format(key, name, structured=True)
    return replace(whole, json_in=_json_of_glb, put_json=_put_json_into_glb)


def _write_inflated_spz(root: Path) -> None:
    """The content of the gzip stream, which is read too: damage to the packed bytes stops at
    gzip."""
    _write_model("b.spz")(root)
    (root / "a.spz").write_bytes(gzip.decompress((root / "b.spz").read_bytes()))


_GLB = struct.Struct("<4sIIII")
"""Header of the file and of its first chunk, which is JSON."""


def _json_of_glb(raw: bytes) -> bytes:
    return raw[_GLB.size : _GLB.size + _GLB.unpack_from(raw)[3]]


def _put_json_into_glb(raw: bytes, text: bytes) -> bytes:
    """With matching lengths, so that readers reach the content of the JSON."""
    magic, version, size, old, kind = _GLB.unpack_from(raw)
    text += b" " * (-len(text) % 4)
    head = _GLB.pack(magic, version, size - old + len(text), len(text), kind)
    return head + text + raw[_GLB.size + old :]


def _write_ksplat(root: Path) -> None:
    (root / "a.ksplat").write_bytes(ksplat_bytes(2))


SPLAT_FORMATS = [
    _model_format("splat", "a.splat"),
    _model_format("spz", "a.spz"),
    _model_format("spz_4", "a.spz", spz_version=4),
    Format("spz_inflated", "a.spz", _write_inflated_spz, _read_model("a.spz")),
    _model_format("sog", "a.sog"),
    _model_format("sog_meta", "meta.json", structured=True),
    _model_format("sog_means", "meta.json", "means_l.webp"),
    _model_format("sog_palette", "meta.json", "shN_centroids.webp"),
    _model_format("glb", "a.glb"),
    _glb_json("glb_json", "a.glb"),
    _glb_json("gltf_spz_json", "a.spz.glb"),
    _model_format("gltf", "a.gltf", structured=True),
    _model_format("gltf_buffer", "a.gltf", "a.bin"),
    _model_format("gltf_spz", "a.spz.glb"),
    Format("ksplat", "a.ksplat", _write_ksplat, _read_model("a.ksplat")),
    _model_format("ply_compressed_written", "a.compressed.ply"),
]
"""Formats of splats but PLY's and USD, which tools/break/usd_files.py attacks."""
FORMATS = [
    *SPLAT_FORMATS,
    *(
        _colmap(name, binary)
        for name in ("cameras", "images", "points3D")
        for binary in (True, False)
    ),
    Format("ply", "a.ply", _plain_ply, _read_splats),
    Format("ply_ascii", "a.ply", _write_ascii_ply, _read_splats),
    Format("ply_compressed", "a.ply", _write_compressed, _read_splats),
    Format("ply_points", "a.ply", _write_points, _read_points),
    Format("mesh_ply", "a.ply", _write_mesh_ply, _read_mesh("a.ply")),
    Format("mesh_obj", "a.obj", _write_mesh_obj, _read_mesh("a.obj")),
    *(
        Format(f"image_{ending[1:]}", f"a{ending}", _write_picture(ending), _read_picture(ending))
        for ending in (".png", ".jpg", ".webp", ".tif", ".bmp", ".tga", ".ppm")
    ),
    Format("image_jpg_restarting", "a.jpg", _write_restarting_jpeg, _read_picture(".jpg")),
    Format("image_png_alpha", "a.png", _write_picture(".png", "RGBA"), _read_picture(".png")),
    Format("image_png_palette", "a.png", _write_picture(".png", "P"), _read_picture(".png")),
    *(
        Format(f"image_{name}", f"a{ending}", _write_numbers(ending, values), _read_picture(ending))
        for name, ending, values in (
            ("png_16_bit", ".png", (_RAMP * 65535).astype(np.uint16)),
            ("tif_16_bit", ".tif", (_RAMP * 65535).astype(np.uint16)),
            ("tif_float", ".tif", _RAMP),
        )
    ),
    Format("transforms", "transforms.json", _write_transforms, _read_transforms, True),
    *(
        Format(f"program_{name}", file, _write_program(write), _read_program, name == "opensfm")
        for name, file, write in (
            ("rs_csv", "registration.csv", program_files.write_rs_csv),
            ("rs_xmp", "0.xmp", program_files.write_rs_xmp),
            ("metashape", "cameras.xml", program_files.write_metashape),
            ("opensfm", "reconstruction.json", program_files.write_opensfm),
            ("llff", "poses_bounds.npy", program_files.write_llff),
        )
    ),
    Format("cameras_json", "cameras.json", _write_cameras, _read_cameras, True),
    Format("world", WORLD_FILE, lambda root: write_up(root, np.array([0.0, 0, 1])), read_up, True),
    Format(
        "depth_params",
        "depth_params.json",
        _write_params,
        lambda root: read_params(root / "depth_params.json"),
        True,
    ),
    Format("config", "config.json", _write_config, _read_config, True),
    Format("sequence", "sequence.json", _write_sequence, _read_sequence, True),
    Format("event", "events.jsonl", _write_event, _read_event, True),
    Format("depth_png", "a.png", _write_depth_png, _read_depth("a.png")),
    Format("depth_npy", "a.npy", _write_npy, _read_depth("a.npy")),
    Format("depth_exr", "a.exr", _write_exr, _read_depth("a.exr")),
    Format("depth_tiff", "a.tif", _write_tiff, _read_depth("a.tif")),
    Format(
        "npz",
        "cameras_sphere.npz",
        _write_npz,
        lambda root: _projections(root / "cameras_sphere.npz"),
    ),
    Format(
        "checkpoint",
        "a.safetensors",
        _write_checkpoint,
        _read_checkpoint,
        True,
        checkpoint_json,
        with_checkpoint_json,
    ),
    Format("cam_txt", "0_cam.txt", _write_cam, lambda root: read_cam(root / "0_cam.txt")),
]
BY_NAME = {one.name: one for one in FORMATS}

"""Splat properties as written by other programs."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import plyfile
import pytest

import gscore
from gscore.errors import ConfigError
from gscore.formats import read_splat_file, write_splat_file
from gscore.io.ply import elements
from gscore.io.ply.comments import stated_up
from gscore.io.ply.splats import read_ply, read_ply_parts, write_splats
from gscore.splats import Splats
from tests.equal_splats import assert_equal_splats


@pytest.fixture
def splats(rng: np.random.Generator) -> Splats:
    """40 random splats of SH degree 1 in front of a camera that faces +z."""
    return Splats(
        means=rng.normal([0, 0, 3], 0.3, (40, 3)).astype(np.float32),
        quats=rng.standard_normal((40, 4), dtype=np.float32),
        scales=rng.normal(-3, 0.5, (40, 3)).astype(np.float32),
        opacities=rng.standard_normal(40, dtype=np.float32),
        sh0=rng.standard_normal((40, 1, 3), dtype=np.float32),
        shN=rng.standard_normal((40, 3, 3), dtype=np.float32),
    )


def _rewritten(path: Path, splats: Splats, **columns: np.ndarray | None) -> None:
    """The official file with more columns, or without those that are None."""
    write_splats(path, splats)
    data = plyfile.PlyData.read(str(path))
    old = data["vertex"].data
    table = {name: old[name] for name in old.dtype.names}
    for name, column in columns.items():
        if column is None:
            del table[name]
        else:
            table[name] = column
    rows = np.rec.fromarrays(list(table.values()), names=list(table))
    plyfile.PlyData([plyfile.PlyElement.describe(np.array(rows), "vertex")]).write(str(path))


def test_the_filter_of_mip_splatting_is_applied(splats: Splats, tmp_path: Path) -> None:
    """Oracle: sizes and opacities by the formula of the paper, worked out splat by splat; a splat
    with a zero filter keeps its bits, also where the file is read in parts."""
    radius = np.linspace(0, 0.2, 40).astype(np.float32)
    _rewritten(tmp_path / "a.ply", splats, filter_3D=radius)
    found = read_ply(tmp_path / "a.ply")
    for k in range(40):
        squares = np.exp(splats.scales[k].astype(float)) ** 2
        wider = squares + float(radius[k]) ** 2
        share = np.sqrt(np.prod(squares) / np.prod(wider))
        np.testing.assert_allclose(np.exp(found.scales[k]), np.sqrt(wider), rtol=1e-6)
        opacity = share / (1 + np.exp(-float(splats.opacities[k])))
        assert 1 / (1 + np.exp(-float(found.opacities[k]))) == pytest.approx(opacity, rel=1e-5)
    assert (found.scales[0] == splats.scales[0]).all() and found.opacities[0] == splats.opacities[0]
    assert found.opacities[39] < splats.opacities[39] - 1
    assert_equal_splats(found, next(read_ply_parts(tmp_path / "a.ply", 40)))


def test_the_picture_of_a_filtered_model(splats: Splats, tmp_path: Path) -> None:
    """Oracle: the picture of covariances widened before writing, with almost the same total
    coverage of the splats."""
    _rewritten(tmp_path / "a.ply", splats, filter_3D=np.full(40, 0.1, np.float32))
    squares = np.exp(2 * splats.scales.astype(float))
    wider = squares + 0.01
    alpha = np.sqrt((squares / wider).prod(axis=1)) / (1 + np.exp(-splats.opacities.astype(float)))
    fused = replace(
        splats,
        scales=(np.log(wider) / 2).astype(np.float32),
        opacities=np.log(alpha / (1 - alpha)).astype(np.float32),
    )
    K = np.array([[80.0, 0, 32], [0, 80, 32], [0, 0, 1]])
    plain, wanted, found = (
        gscore.render(s, K, np.eye(4), 64, 64).rgb for s in (splats, fused, tmp_path / "a.ply")
    )
    assert np.abs(found - wanted).max() < 1e-4 < np.abs(plain - wanted).max()


def test_discs_of_2dgs(splats: Splats, tmp_path: Path) -> None:
    """Oracle: the two sizes of the file, and a millionth of a unit for the third."""
    _rewritten(tmp_path / "a.ply", splats, scale_2=None)
    found = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(found.scales[:, :2], splats.scales[:, :2])
    np.testing.assert_allclose(found.scales[:, 2], np.log(1e-6), rtol=1e-6)


@pytest.mark.parametrize("text", [True, False])
def test_names_of_cloudcompare(splats: Splats, text: bool, tmp_path: Path) -> None:
    """Oracle: the same splats under their own names; positions and normals have no prefix."""
    write_splats(tmp_path / "a.ply", splats)
    old = plyfile.PlyData.read(str(tmp_path / "a.ply"))["vertex"].data
    kept = ("x", "y", "z", "nx", "ny", "nz")
    names = [name if name in kept else f"scalar_{name}" for name in old.dtype.names]
    rows = np.rec.fromarrays([old[name] for name in old.dtype.names], names=names)
    element = plyfile.PlyElement.describe(np.array(rows), "vertex")
    plyfile.PlyData([element], text=text).write(str(tmp_path / "b.ply"))
    found = read_ply(tmp_path / "b.ply")
    for item in fields(Splats):
        wanted = getattr(splats, item.name)
        np.testing.assert_allclose(getattr(found, item.name), wanted, rtol=1e-6 if text else 0)


@pytest.mark.parametrize("name", ["a.ply", "a.compressed.ply", "a.spz", "a.sog", "a.splat"])
def test_flat_splats_are_written(splats: Splats, name: str, tmp_path: Path) -> None:
    """Oracle: all splats, and no note of any that is left out."""
    splats.scales[:16, 1] = -np.inf
    reported = write_splat_file(tmp_path / name, splats)
    assert not any("left out" in note for note in reported.notes)
    found = read_splat_file(tmp_path / name)
    assert len(found.splats) == 40 and not found.notes
    assert np.count_nonzero((found.splats.scales < -8).any(axis=1)) == 16


@pytest.mark.parametrize(
    ("line", "axis"),
    [
        ("Vertical Axis: z", "Z"), ("vertical axis: Z", "Z"), ("Vertical axis: -z", "-Z"),
        ("Vertical Axis: x", "X"), ("Vertical Axis: +y", "Y"), ("Vertical Axis: -y", "-Y"),
        ("Vertical axis: y", ""), ("gscore up Z", "Z"), ("gscore up Y", "Y"),
        ("Created by X, Vertical axis: Z", "Z"), ("X (vertical axis = -z)", "-Z"),
        ("X 1.2; up axis: y", "Y"), ("up_axis z", "Z"), ("UpAxis: -Y", "-Y"),
        ("Made by X - Up Axis: +X", "X"), ("setup axis: z", ""),
        ("Created by X, Vertical axis: Y", ""), ("Vertical Axis: zeta", ""),
        ("no vertical axis: z", ""),
    ],
)  # fmt: skip
def test_the_axis_that_a_comment_states(line: str, axis: str) -> None:
    """Oracle: the comments of nerfstudio, Brush (always y, for any up direction) and gscore."""
    assert stated_up(["made by hand", line]) == axis


@pytest.mark.parametrize("text", ["ü" * 1000, "end_header", "element vertex 7", "c " * 200_000])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("line_end", [b"\n", b"\r\n", b"\r"])
def test_comments_cost_no_letter_of_the_rows(
    splats: Splats, text: str, mark: bytes, line_end: bytes, tmp_path: Path
) -> None:
    """Oracle: the model without comments; plyfile, which parses headers character by character, is
    given less than a thousand of them."""
    write_splats(tmp_path / "a.ply", splats)
    head, rows = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    comments = f"comment {text}\nobj_info {text}\ncomment\n".encode()
    head = head.replace(b"element", comments + b"element", 1)
    head = (head + b"end_header\n").replace(b"\n", line_end)
    (tmp_path / "b.ply").write_bytes(mark + head + rows)
    asked = []

    class Counted(elements._PlainHeader):
        def read(self, size: int | None = -1, /) -> bytes:
            asked.append(size)
            return super().read(size)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(elements, "_PlainHeader", Counted)
        assert_equal_splats(read_ply(tmp_path / "b.ply"), splats)
    assert 100 < len(asked) < 1000


@pytest.mark.parametrize("name", ["a.ply", "a.compressed.ply"])
def test_comments_that_no_reader_takes(splats: Splats, name: str, tmp_path: Path) -> None:
    """Oracle: one sentence and no file, for a header above the reader's limit; a readable file just
    below it."""
    with pytest.raises(ConfigError, match="Shorten its comments"):
        write_splat_file(tmp_path / name, splats, comments=("ü" * 300_000,))
    assert not [*tmp_path.iterdir()]
    write_splat_file(tmp_path / name, splats, comments=("ü" * 250_000,))
    assert len(read_ply(tmp_path / name)) == 40

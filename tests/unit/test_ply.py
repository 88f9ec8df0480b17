"""Splat PLY in every dialect, checked with plyfile and by hand."""

import logging
import os
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np
import plyfile
import pytest

from gscore.errors import DatasetError, FormatError, GsError
from gscore.io.ply.points import read_point_cloud
from gscore.io.ply.splats import (
    MIP_COMMENT,
    header_comments,
    is_antialiased_ply,
    read_ply,
    write_splats,
)
from gscore.splats import SH_REST_BY_DEGREE, Splats
from tests.equal_splats import assert_equal_splats
from tests.lines_run import lines_run


@pytest.fixture
def make_splats(rng: np.random.Generator) -> Callable[..., Splats]:
    """Random splats of a degree."""

    def make(count: int = 50, degree: int = 3) -> Splats:
        def normal(*shape: int) -> np.ndarray:
            return rng.standard_normal(shape, dtype=np.float32)

        return Splats(
            means=normal(count, 3),
            quats=normal(count, 4),
            scales=normal(count, 3),
            opacities=normal(count),
            sh0=normal(count, 1, 3),
            shN=normal(count, SH_REST_BY_DEGREE[degree], 3),
        )

    return make


def _columns(splats: Splats) -> dict[str, np.ndarray]:
    """Properties by name, written out by hand from the public description of the format."""
    out = {name: splats.means[:, k] for k, name in enumerate("xyz")}
    out |= {f"f_dc_{c}": splats.sh0[:, 0, c] for c in range(3)}
    rest = splats.shN.shape[1]
    for c in range(3):
        out |= {f"f_rest_{c * rest + k}": splats.shN[:, k, c] for k in range(rest)}
    out["opacity"] = splats.opacities
    out |= {f"scale_{k}": splats.scales[:, k] for k in range(3)}
    out |= {f"rot_{k}": splats.quats[:, k] for k in range(4)}
    return out


def _write(
    path: Path, columns: dict[str, np.ndarray], *, text: bool = False, order: str = "<"
) -> None:
    table = np.zeros(len(next(iter(columns.values()))), [(n, c.dtype) for n, c in columns.items()])
    for name, column in columns.items():
        table[name] = column
    element = plyfile.PlyElement.describe(table, "vertex")
    plyfile.PlyData([element], text=text, byte_order=order).write(str(path))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_writes_the_official_layout(degree: int, make_splats: Callable, tmp_path: Path) -> None:
    """Oracle: names and order of the official files, values as read by plyfile."""
    splats = make_splats(degree=degree)
    write_splats(tmp_path / "a.ply", splats, comments=("SplatRenderMode: mip",))
    data = plyfile.PlyData.read(str(tmp_path / "a.ply"))
    vertex = data["vertex"]
    rest = [f"f_rest_{k}" for k in range(3 * SH_REST_BY_DEGREE[degree])]
    assert [p.name for p in vertex.properties] == [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
        *rest,
        *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]
    assert all(p.val_dtype == "f4" for p in vertex.properties)
    assert data.byte_order == "<" and not data.text
    assert data.comments == ["SplatRenderMode: mip"]
    for name, column in _columns(splats).items():
        np.testing.assert_array_equal(vertex[name], column, name)
    assert not any(vertex[name].any() for name in ("nx", "ny", "nz"))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_round_trip_to_the_bit(degree: int, make_splats: Callable, tmp_path: Path) -> None:
    """Oracle: the written splats, more than one block, zeros of both signs, denormals."""
    splats = make_splats(40_000, degree)
    splats.means[:3, 0] = [-0.0, 1e-42, 3.4e38]
    write_splats(tmp_path / "a.ply", splats)
    again = read_ply(tmp_path / "a.ply")
    assert_equal_splats(again, splats)
    assert np.signbit(again.means[0, 0])
    assert all(getattr(again, item.name).flags.c_contiguous for item in fields(Splats))


def test_no_line_runs_once_per_splat(make_splats: Callable, tmp_path: Path) -> None:
    """Oracle: the count of lines for one splat: ten thousand, one block too, take no more."""

    def lines(count: int) -> tuple[int, int]:
        path, splats = tmp_path / f"{count}.ply", make_splats(count)
        return lines_run(lambda: write_splats(path, splats)), lines_run(lambda: read_ply(path))

    lines(1)  # modules are loaded
    assert np.subtract(lines(10_000), lines(1)).max() < 100


class TestDialects:
    """Files of other programs."""

    def test_any_order_and_more_properties(self, make_splats: Callable, tmp_path: Path) -> None:
        """Oracle: the same splats, with shuffled columns, without normals, with extra columns
        between."""
        splats = make_splats()
        columns = _columns(splats)
        names = sorted(columns, key=lambda name: name[::-1])
        mixed: dict[str, np.ndarray] = {"t": np.zeros(50, np.uint8)}
        for name in names:
            mixed[name] = columns[name]
        mixed["segment"] = np.arange(50, dtype=np.int32)
        _write(tmp_path / "a.ply", mixed)
        assert_equal_splats(read_ply(tmp_path / "a.ply"), splats)

    @pytest.mark.parametrize(("text", "order"), [(True, "="), (False, ">")])
    def test_text_and_big_endian(
        self, text: bool, order: str, make_splats: Callable, tmp_path: Path
    ) -> None:
        """Oracle: the same splats written by plyfile (text with 8 digits)."""
        splats = make_splats(degree=1)
        _write(tmp_path / "a.ply", _columns(splats), text=text, order=order)
        again = read_ply(tmp_path / "a.ply")
        np.testing.assert_allclose(again.shN, splats.shN, rtol=1e-6 if text else 0)
        np.testing.assert_allclose(again.quats, splats.quats, rtol=1e-6 if text else 0)

    def test_doubles(self, make_splats: Callable, tmp_path: Path) -> None:
        """Oracle: the same numbers, stored as doubles."""
        splats = make_splats(degree=0)
        wide = {name: column.astype(np.float64) for name, column in _columns(splats).items()}
        _write(tmp_path / "a.ply", wide)
        assert_equal_splats(read_ply(tmp_path / "a.ply"), splats)

    def test_bytes_as_color(self, make_splats: Callable, tmp_path: Path) -> None:
        """Oracle: the byte from colour = 0.5 + 0.2820948 f_dc."""
        splats = make_splats(degree=0)
        columns = {n: c for n, c in _columns(splats).items() if not n.startswith("f_dc")}
        rgb = np.arange(150, dtype=np.uint8).reshape(50, 3)
        for c, name in enumerate(("red", "green", "blue")):
            columns[name] = rgb[:, c]
        _write(tmp_path / "a.ply", columns)
        again = read_ply(tmp_path / "a.ply")
        np.testing.assert_allclose(
            (0.5 + 0.28209479177387814 * again.sh0[:, 0]) * 255, rgb, atol=1e-4
        )
        assert again.sh_degree == 0

    def test_degree_5_is_cut(
        self, make_splats: Callable, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        """Oracle: the first 24 of 35 coefficients a channel."""
        splats = make_splats(degree=0)
        columns = _columns(splats)
        rest = np.arange(105, dtype=np.float32)
        for k in range(105):
            columns[f"f_rest_{k}"] = np.full(50, rest[k])
        _write(tmp_path / "a.ply", columns)
        with caplog.at_level(logging.WARNING):
            again = read_ply(tmp_path / "a.ply")
        assert again.sh_degree == 4
        np.testing.assert_array_equal(again.shN[0], rest.reshape(3, 35)[:, :24].T)
        assert "35 SH coefficients" in caplog.text and "first 24" in caplog.text

    def test_incomplete_band_is_cut(self, make_splats: Callable, tmp_path: Path) -> None:
        """Oracle: one whole band of 3 from 5 coefficients a channel."""
        columns = _columns(make_splats(degree=0))
        for k in range(15):
            columns[f"f_rest_{k}"] = np.full(50, k, np.float32)
        _write(tmp_path / "a.ply", columns)
        again = read_ply(tmp_path / "a.ply")
        np.testing.assert_array_equal(again.shN[0], [[0, 5, 10], [1, 6, 11], [2, 7, 12]])

    def test_broken_rows_are_left_out(
        self, make_splats: Callable, tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        """Oracle: the rows damaged by hand, counted; an opacity of +inf means opaque, a log scale
        of -inf flat."""
        splats = make_splats()
        splats.means[3, 1] = np.nan
        splats.shN[4, 7, 2] = np.inf
        splats.quats[5] = 0
        splats.scales[6, 0] = -np.inf
        splats.opacities[7] = np.inf
        splats.opacities[8] = -np.inf
        write_splats(tmp_path / "a.ply", splats)
        with caplog.at_level(logging.WARNING):
            again = read_ply(tmp_path / "a.ply")
        assert len(again) == 46
        assert again.scales[3, 0] == np.float32(np.log(1e-12)) and again.opacities[4] == 20
        assert "4 of 50 splats have numbers that are not finite" in caplog.text

    def test_no_splats(self, make_splats: Callable, tmp_path: Path) -> None:
        """Oracle: an empty model, which is valid."""
        write_splats(tmp_path / "a.ply", make_splats(0))
        again = read_ply(tmp_path / "a.ply")
        assert len(again) == 0 and again.sh_degree == 3


class TestRefusals:
    """Refusal in one sentence of files that are no splat model."""

    def test_point_cloud(self, tmp_path: Path) -> None:
        """Oracle: the sentence, with the missing property and the option to choose."""
        points = {name: np.zeros(4, np.float32) for name in "xyz"}
        _write(tmp_path / "points.ply", points | {"red": np.zeros(4, np.uint8)})
        with pytest.raises(FormatError) as caught:
            read_ply(tmp_path / "points.ply")
        message = str(caught.value)
        assert "points.ply has no Gaussian splats: its vertices lack opacity, scale_0" in message
        assert "plain mesh or point cloud" in message and message.count(". ") == 0

    def test_no_vertices(self, tmp_path: Path) -> None:
        """Oracle: a PLY of faces only."""
        face = np.zeros(1, [("a", "i4")])
        element = plyfile.PlyElement.describe(face, "face")
        plyfile.PlyData([element]).write(str(tmp_path / "a.ply"))
        with pytest.raises(FormatError, match="has no Gaussian splats"):
            read_ply(tmp_path / "a.ply")

    def test_other_files(self, tmp_path: Path) -> None:
        """Oracle: missing file, other contents, header without an end."""
        with pytest.raises(DatasetError, match=r"Cannot read .*none\.ply"):
            read_ply(tmp_path / "none.ply")
        (tmp_path / "a.ply").write_bytes(b"\x7fELF\r\n")
        with pytest.raises(FormatError, match="is not a PLY file"):
            read_ply(tmp_path / "a.ply")
        (tmp_path / "a.ply").write_bytes(b"ply\nformat ascii 1.0\n")
        with pytest.raises(FormatError, match="no end_header"):
            read_ply(tmp_path / "a.ply")

    def test_gaps_in_rest(self, make_splats: Callable, tmp_path: Path) -> None:
        """Oracle: f_rest_2 left out."""
        columns = _columns(make_splats(degree=1))
        del columns["f_rest_2"]
        _write(tmp_path / "a.ply", columns)
        with pytest.raises(FormatError, match="not numbered 0 to 7"):
            read_ply(tmp_path / "a.ply")

    def test_rest_not_of_three_channels(self, make_splats: Callable, tmp_path: Path) -> None:
        """Oracle: seven coefficients, which cannot be three channels."""
        columns = _columns(make_splats(degree=1))
        del columns["f_rest_8"], columns["f_rest_7"]
        _write(tmp_path / "a.ply", columns)
        with pytest.raises(FormatError, match="expected 0, 9, 24, 45 or 72"):
            read_ply(tmp_path / "a.ply")

    def test_list_in_place_of_number(self, make_splats: Callable, tmp_path: Path) -> None:
        """Oracle: opacity stored as a list."""
        columns = _columns(make_splats(2, 0))
        table = np.zeros(2, [(n, "O" if n == "opacity" else "f4") for n in columns])
        table["opacity"] = [np.zeros(2, np.float32)] * 2
        plyfile.PlyData(
            [plyfile.PlyElement.describe(table, "vertex", val_types={"opacity": "f4"})]
        ).write(str(tmp_path / "a.ply"))
        with pytest.raises(FormatError, match="opacity is a list"):
            read_ply(tmp_path / "a.ply")

    def test_every_truncation(self, make_splats: Callable, tmp_path: Path) -> None:
        """Oracle: a refusal of a file cut anywhere, with its name."""
        path = tmp_path / "a.ply"
        write_splats(path, make_splats(3, 0))
        good = path.read_bytes()
        for cut in range(len(good)):
            path.write_bytes(good[:cut])
            with pytest.raises(FormatError, match=r"a\.ply"):
                read_ply(path)

    def test_huge_count(self, make_splats: Callable, tmp_path: Path) -> None:
        """Oracle: a refusal of 10^15 vertices without allocation."""
        path = tmp_path / "a.ply"
        write_splats(path, make_splats(3, 0))
        path.write_bytes(path.read_bytes().replace(b"vertex 3", b"vertex 1000000000000000"))
        with pytest.raises(FormatError, match="announces 1000000000000000 rows of vertex"):
            read_ply(path)

    @pytest.mark.parametrize("text", [True, False])
    def test_hostile(
        self, text: bool, make_splats: Callable, mutations: Callable, tmp_path: Path
    ) -> None:
        """Oracle: splats or one of our errors, for a damaged file; no other exception."""
        path, refused = tmp_path / "a.ply", 0
        _write(path, _columns(make_splats(4, 1)), text=text)
        for raw in mutations(path.read_bytes()):
            path.write_bytes(raw)
            for read in (read_ply, read_point_cloud):
                try:
                    read(path)
                except GsError:
                    refused += 1
        assert refused > 40


@pytest.mark.skipif(os.name == "nt", reason="needs /dev/full")
def test_failed_write_leaves_the_old_model(make_splats: Callable, tmp_path: Path) -> None:
    """Oracle: the old file, when its folder's name is taken by a file."""
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(GsError, match="Cannot write"):
        write_splats(tmp_path / "file" / "a.ply", make_splats())
    assert (tmp_path / "file").read_text() == "in the way"


class TestPointClouds:
    """Plain points, as transforms.json captures have them."""

    @pytest.mark.parametrize("kind", ["u1", "u2", "f4"])
    def test_colors(self, kind: str, tmp_path: Path) -> None:
        """Oracle: full and half intensity in each type."""
        top = 1.0 if kind == "f4" else np.iinfo(kind).max
        columns = {name: np.arange(2, dtype=np.float64) for name in "xyz"}
        for name in ("red", "green", "blue"):
            columns[name] = np.array([top, top / 2]).astype(kind)
        _write(tmp_path / "a.ply", columns)
        cloud = read_point_cloud(tmp_path / "a.ply")
        assert cloud.points.tolist() == [[0, 0, 0], [1, 1, 1]]
        assert (cloud.colors[0] == 255).all() and (
            abs(cloud.colors[1].astype(int) - 127) <= 1
        ).all()

    def test_without_colors(self, tmp_path: Path) -> None:
        """Oracle: black."""
        _write(tmp_path / "a.ply", {name: np.ones(2, np.float32) for name in "xyz"})
        assert not read_point_cloud(tmp_path / "a.ply").colors.any()

    def test_no_points(self, tmp_path: Path) -> None:
        """Oracle: the sentence, with the missing property."""
        _write(tmp_path / "a.ply", {"x": np.ones(2, np.float32)})
        with pytest.raises(FormatError, match="lack y, z"):
            read_point_cloud(tmp_path / "a.ply")


def test_antialiasing_is_read_from_the_header(
    tmp_path: Path, make_splats: Callable[..., Splats]
) -> None:
    """Oracle: the written comment; a missing file is named."""
    splats = make_splats(5, 0)
    write_splats(tmp_path / "plain.ply", splats, comments=("SplatRenderMode: default",))
    write_splats(tmp_path / "mip.ply", splats, comments=("made by hand", MIP_COMMENT))
    assert not is_antialiased_ply(tmp_path / "plain.ply")
    assert is_antialiased_ply(tmp_path / "mip.ply")
    write_splats(tmp_path / "other.ply", splats, comments=("Antialiased: 1",))
    assert is_antialiased_ply(tmp_path / "other.ply")
    with pytest.raises(DatasetError, match=r"none\.ply"):
        is_antialiased_ply(tmp_path / "none.ply")


def test_negative_count_is_refused(make_splats: Callable, tmp_path: Path) -> None:
    """Oracle: the sentence, with the count and without text of an array library."""
    path = tmp_path / "a.ply"
    write_splats(path, make_splats())
    raw = path.read_bytes()
    at = raw.index(b"element vertex ")
    end = raw.index(b"\n", at)
    path.write_bytes(raw[:at] + b"element vertex -5" + raw[end:])
    with pytest.raises(FormatError, match="its header announces '-5' rows"):
        read_ply(path)


def test_trailing_bytes_warn(
    make_splats: Callable, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Oracle: a header that states a row less than the file has."""
    path = tmp_path / "a.ply"
    splats = make_splats()
    write_splats(path, splats)
    assert len(read_ply(path)) == len(splats)
    assert not caplog.records
    raw = path.read_bytes()
    fewer = f"element vertex {len(splats) - 1}".encode()
    path.write_bytes(raw.replace(f"element vertex {len(splats)}".encode(), fewer, 1))
    assert len(read_ply(path)) == len(splats) - 1
    width = 4 * (17 + splats.shN.shape[1] * 3)
    assert f"{width} bytes after the last row its header announces" in caplog.text


def test_trailing_lines_warn(
    make_splats: Callable, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Oracle: a text file that states two rows less than it has; empty lines do not count."""
    path = tmp_path / "a.ply"
    _write(path, _columns(make_splats(9)), text=True)
    path.write_bytes(path.read_bytes() + b"\n\n")
    assert len(read_ply(path)) == 9
    assert not caplog.records
    path.write_bytes(path.read_bytes().replace(b"element vertex 9", b"element vertex 7", 1))
    assert len(read_ply(path)) == 7
    assert "2 lines after the last row its header announces are not read" in caplog.text


@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_any_letters_in_comments_and_a_byte_order_mark(
    mark: bytes, text: bool, make_splats: Callable, tmp_path: Path
) -> None:
    """Oracle: the same model without them; plyfile alone accepts neither."""
    path = tmp_path / "a.ply"
    _write(path, _columns(make_splats(9)), text=text)
    plain = read_ply(path)
    comment = "comment größer, 大, \xad\ncomment SplatRenderMode: mip\n".encode()
    raw = path.read_bytes()
    path.write_bytes(mark + raw.replace(b"element vertex", comment + b"element vertex", 1))
    found = read_ply(path)
    for field in fields(plain):
        np.testing.assert_array_equal(getattr(found, field.name), getattr(plain, field.name))
    assert header_comments(path)[0].startswith("größer, 大")
    assert is_antialiased_ply(path)


def test_comments_of_any_letters_and_lines_are_written(
    make_splats: Callable, tmp_path: Path
) -> None:
    """Oracle: plyfile, which accepts ASCII alone, reads the comments and the same number of
    rows."""
    path = tmp_path / "a.ply"
    write_splats(path, make_splats(), comments=("größer\nend_header\r\nzwei", MIP_COMMENT))
    found = plyfile.PlyData.read(str(path))
    assert found.comments == ["gr\\xf6\\xdfer", "end_header", "zwei", MIP_COMMENT]
    assert len(found["vertex"]) == len(read_ply(path)) == 50


@pytest.mark.parametrize("count", [b"9" * 400, b"9" * 5000])
def test_counts_of_many_digits(count: bytes, make_splats: Callable, tmp_path: Path) -> None:
    """Oracle: one short sentence."""
    path = tmp_path / "a.ply"
    write_splats(path, make_splats())
    path.write_bytes(path.read_bytes().replace(b"vertex 50", b"vertex " + count, 1))
    with pytest.raises(FormatError, match="its header announces '999") as error:
        read_ply(path)
    assert len(str(error.value)) < 500

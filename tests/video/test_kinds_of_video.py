"""Videos of cameras and programs, and files that are no videos."""

import wave
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image

from gscore.commands import main
from gscore.commands.photo_folder_info import video_facts
from gscore.errors import FormatError
from gscore.video import ExtractRequest, Frames, extract_frames
from gscore.video.frame_image import to_screen
from gscore.video.source import damage_text, opened_video
from tests.light_changes import encode

from . import films

Out = pytest.CaptureFixture[str]
_TURNED = {
    "90 clockwise": ((0, 1, -1, 0), lambda p: np.rot90(p, -1)),
    "180": ((-1, 0, 0, -1), lambda p: np.rot90(p, 2)),
    "270 clockwise": ((0, -1, 1, 0), lambda p: np.rot90(p, 1)),
    "mirrored": ((-1, 0, 0, 1), np.fliplr),
    "flipped": ((1, 0, 0, -1), np.flipud),
    "transposed": ((0, 1, 1, 0), lambda p: p.transpose(1, 0, 2)),
    "transposed and turned": ((0, -1, -1, 0), lambda p: np.rot90(p.transpose(1, 0, 2), 2)),
    "all zero": ((0, 0, 0, 0), lambda p: p),
    "one line": ((1, 1, 0, 0), lambda p: p),
}
"""a b c d of the matrix of a track (ISO 14496-12, 6.2.2): the pixel at x, y comes to a x + c y, b x
+ d y; and the same for a picture. The last two are degenerate, so they are left out."""
_UPRIGHT = b"".join(n.to_bytes(4, "big") for n in (0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000))


@pytest.fixture
def walk() -> list[np.ndarray]:
    """A second and a half."""
    return films.walk(45)


def _frames(path: Path, tmp_path: Path, *, count: int = 6, kind: str = "png") -> Frames:
    return extract_frames(
        ExtractRequest(video=path, output=tmp_path / "out", frames=count, format=kind)
    )


def _first(frames: Frames) -> tuple[int, np.ndarray]:
    """Number and pixels of the first one."""
    name = frames.names[0]
    return int(name[6:12]), np.asarray(Image.open(frames.folder / name)).astype(int)


@pytest.mark.parametrize("name", list(_TURNED))
def test_turned_and_mirrored_video_is_shown_as_stated(
    walk: list[np.ndarray], tmp_path: Path, name: str
) -> None:
    """Oracle: the matrix of ISO 14496-12, written into the file by hand; the size of the frames in
    `info`."""
    path = films.write(tmp_path / "phone.mp4", walk)
    (a, b, c, d), turn = _TURNED[name]
    values = (a << 16, b << 16, 0, c << 16, d << 16, 0, 0, 0, 1 << 30)
    matrix = b"".join(n.to_bytes(4, "big", signed=True) for n in values)
    data = path.read_bytes()
    track = data.index(b"tkhd")
    at = data.index(_UPRIGHT, track)
    path.write_bytes(data[:at] + matrix + data[at + len(matrix) :])
    index, pixels = _first(_frames(path, tmp_path))
    true = turn(walk[index]).astype(int)
    assert pixels.shape == true.shape
    assert np.abs(pixels - true).mean() < 12
    stated = video_facts(path)
    assert (stated["height"], stated["width"]) == true.shape[:2]


def _joined(folder: Path, first: list[np.ndarray], second: list[np.ndarray]) -> Path:
    """Two transport streams one after the other, as in files of recorders and `cat`."""
    parts = [films.write(folder / f"{i}.ts", film) for i, film in enumerate((first, second))]
    (folder / "joined.ts").write_bytes(b"".join(part.read_bytes() for part in parts))
    return folder / "joined.ts"


def test_comments_in_other_encodings_do_no_harm(walk: list[np.ndarray], tmp_path: Path) -> None:
    """Oracle: the size of a video whose comment is in Latin-1."""
    path = films.write(tmp_path / "walk.mp4", walk[:3], comment="Caaaa")
    path.write_bytes(path.read_bytes().replace(b"Caaaa", "Cafés".encode("latin-1")))
    with opened_video(path) as video:
        assert (video.facts.width, video.facts.height) == (films.WIDTH, films.HEIGHT)


@pytest.mark.parametrize(("version", "known"), [("18.1.0", True), ("19.0.2", False)])
def test_every_version_of_pyav_opens_videos(
    walk: list[np.ndarray],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    version: str,
    known: bool,
) -> None:
    """Oracle: the signatures of `av.open`: 19.0 has dropped `metadata_errors`."""
    path = films.write(tmp_path / "walk.mp4", walk[:3])
    given: dict[str, Any] = {}

    def open_as_given(file: str, *, options: dict[str, str], **more: str) -> Any:
        given.update(more)
        return av_open(file, options=options)

    av_open = av.open
    monkeypatch.setattr(av, "open", open_as_given)
    monkeypatch.setattr(av, "__version__", version)
    with opened_video(path):
        assert ("metadata_errors" in given) is known


def test_the_time_goes_on_where_videos_were_joined(tmp_path: Path) -> None:
    """Oracle: 45 frames and 45 more at 30 a second, for any restart of the time stamps."""
    walk = films.walk(90)
    done = _frames(_joined(tmp_path, walk[:45], walk[45:]), tmp_path, count=9)
    assert done.total == 90
    assert np.allclose(done.seconds, [int(name[6:12]) / 30 for name in done.names], atol=1e-3)


def test_videos_of_two_sizes_in_one_are_refused(
    walk: list[np.ndarray], tmp_path: Path, capsys: Out
) -> None:
    """Oracle: both written sizes in one sentence; no frames."""
    large = [np.repeat(np.repeat(picture, 2, 0), 2, 1) for picture in walk]
    path = _joined(tmp_path, walk, large)
    assert main(["frames", str(path), "-o", str(tmp_path / "out"), "--quiet"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "joins videos of two sizes: 45 frames of 480 x 272 px, others of 960 x 544 px" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("box", [b"mdhd", b"mvhd"])
def test_times_that_hide_all_frames_but_one_are_named(
    box: bytes, walk: list[np.ndarray], tmp_path: Path, capsys: Out
) -> None:
    """Oracle: 45 frames in the file; the time base of its track or of its edit list is changed, so
    that the edit list ends after the first."""
    path = films.write(tmp_path / "odd.mp4", walk)
    data = bytearray(path.read_bytes())
    at = data.index(box) + 16  # ISO 14496-12, 8.2.2 and 8.4.2: version 0, timescale
    data[at : at + 4] = (7 if box == b"mdhd" else 90_000).to_bytes(4, "big")
    path.write_bytes(data)
    assert main(["frames", str(path), "-o", str(tmp_path / "out"), "--quiet"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "states 45 frames, but only one is displayed" in said


@pytest.mark.parametrize("seed", [16, 44, 48, 95])
def test_flipped_bits_of_packet_headers_are_damage(
    seed: int, walk: list[np.ndarray], tmp_path: Path
) -> None:
    """Oracle: at most the 45 original frames, or the sentence that none is left: PyAV ends such
    transport streams, in which damage makes new streams, with an IndexError."""
    data = bytearray(_with_sound(tmp_path / "hurt.ts", walk).read_bytes())
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 40))
    for at in rng.integers(0, len(data) // 188, count) * 188 + rng.integers(0, 4):
        data[at] ^= 1 << int(rng.integers(8))
    (tmp_path / "hurt.ts").write_bytes(data)
    try:
        with opened_video(tmp_path / "hurt.ts") as video:
            assert 1 < sum(1 for _ in video.frames()) < 45
            assert "damaged frame" in damage_text(video, 1.5)
    except FormatError as error:
        assert "can be decoded: it is damaged" in str(error)


def _with_sound(path: Path, walk: list[np.ndarray]) -> Path:
    with av.open(str(path), "w") as file:
        video: Any = file.add_stream("libx264", rate=30, options={"crf": "12", "g": "10"})
        sound: Any = file.add_stream("mp2", rate=44100)
        video.height, video.width, video.pix_fmt = *walk[0].shape[:2], "yuv420p"
        for index, picture in enumerate(walk):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = index, Fraction(1, 30)
            file.mux(video.encode(frame))
            quiet = np.zeros((1, 2304), np.int16)
            silence = av.AudioFrame.from_ndarray(quiet, format="s16", layout="stereo")
            silence.rate, silence.pts = 44100, index * 1152
            file.mux(sound.encode(silence))
        file.mux(video.encode())
        file.mux(sound.encode())
    return path


def test_times_are_those_of_a_variable_rate(walk: list[np.ndarray], tmp_path: Path) -> None:
    """Oracle: the written times of the frames."""
    gaps = np.random.default_rng(0).integers(10, 120, len(walk)) / 1000
    times = np.cumsum(gaps) - gaps[0]
    path = films.write(tmp_path / "vfr.mp4", walk, times=times.tolist())
    done = _frames(path, tmp_path)
    assert np.allclose(done.seconds, [times[int(name[6:12])] for name in done.names], atol=2e-3)


def test_pixels_become_square(walk: list[np.ndarray], tmp_path: Path) -> None:
    """Oracle: 640 columns from 480 of 4:3 pixels, 363 lines from 272 of 3:4 pixels; none is
    lost."""
    wide = films.write(tmp_path / "wide.mp4", walk, aspect=Fraction(4, 3))
    done = _frames(wide, tmp_path / "a")
    assert (done.width, done.height) == (640, 272)
    narrow = films.write(tmp_path / "narrow.mp4", walk, aspect=Fraction(3, 4))
    done = _frames(narrow, tmp_path / "b")
    assert (done.width, done.height) == (480, 363)


def test_fields_of_two_moments_are_parted(tmp_path: Path) -> None:
    """Oracle: the picture of one moment; no combs from lines of two moments."""
    moments = films.walk(90, step=5.0)
    woven = []
    for first, second in zip(moments[::2], moments[1::2], strict=True):
        both = first.copy()
        both[1::2] = second[1::2]
        woven.append(both)
    path = films.write(
        tmp_path / "tv.mp4", woven, options={"crf": "8", "x264-params": "tff=1"}, interlaced=True
    )
    with opened_video(path) as video:
        assert video.facts.interlaced
    index, pixels = _first(_frames(path, tmp_path))

    def combs(picture: np.ndarray) -> float:
        grey = picture.astype(float).mean(axis=2)
        return float(np.abs(2 * grey[1:-1] - grey[:-2] - grey[2:]).mean())

    assert combs(pixels) < 0.75 * combs(woven[index])
    assert combs(pixels) < 1.1 * combs(moments[2 * index])


def test_ten_bits_are_rounded(walk: list[np.ndarray], tmp_path: Path) -> None:
    """Oracle: the original pictures."""
    path = films.write(tmp_path / "ten.mp4", walk, codec="libx265", pix_fmt="yuv420p10le")
    index, pixels = _first(_frames(path, tmp_path))
    assert np.abs(pixels - walk[index]).mean() < 12


@pytest.mark.parametrize(("kind", "white"), [("HDR (PQ)", 0.5807), ("HDR (HLG)", 0.75)])
def test_paper_is_white_in_hdr(kind: str, white: float) -> None:
    """Oracle: BT.2408: these signals are a white sheet; greys stay grey and in order."""
    signal = np.linspace(0, 1, 257)
    signal[200] = white
    signal.sort()
    codes = np.rint(signal * 65535).astype(np.uint16)
    grey = np.repeat(codes[None, :, None], 3, axis=2)
    out = to_screen(grey, kind, wide=True)[0].astype(int)
    assert np.ptp(out, axis=1).max() <= 1
    assert (np.diff(out[:, 0]) >= 0).all() and out[0, 0] == 0 and out[-1, 0] >= 254
    paper = out[np.searchsorted(signal, white), 0]
    assert 225 <= paper <= 245


def test_colours_of_bt2020_are_turned() -> None:
    """Oracle: BT.2087: red of BT.709 has these shares of BT.2020's primaries."""
    share = np.array([0.6274, 0.0691, 0.0164])
    light = share * 100 / 10000  # 100 cd/m2
    m1, m2, c1, c2, c3 = 0.1593017578125, 78.84375, 0.8359375, 18.8515625, 18.6875
    signal = ((c1 + c2 * light**m1) / (1 + c3 * light**m1)) ** m2
    pixel = np.rint(signal * 65535).astype(np.uint16)[None, None]
    red, green, blue = to_screen(pixel, "HDR (PQ)", wide=True)[0, 0]
    linear = 0.9 * 100 / 203
    assert red == pytest.approx(255 * float(encode(linear)), abs=2)
    assert max(green, blue) <= 6


@pytest.mark.parametrize(("transfer", "white"), [(16, 0.5807), (18, 0.75)])
def test_hdr_video_comes_out_for_a_screen(tmp_path: Path, transfer: int, white: float) -> None:
    """Oracle: BT.2408's white in a file with the numbers of H.273 for BT.2020."""
    shades = np.stack([picture.mean(axis=2) for picture in films.walk(45)])
    shades = (shades - shades.min()) / np.ptp(shades)  # 0 black, 1 paper
    deep = [np.rint(s[..., None].repeat(3, 2) * white * 65535).astype(np.uint16) for s in shades]
    path = films.write(
        tmp_path / "hdr.mp4",
        deep,
        codec="libx265",
        pix_fmt="yuv420p10le",
        color=(9, transfer, 9),
        source="rgb48le",
    )
    with opened_video(path) as video:
        assert video.facts.hdr
    done = _frames(path, tmp_path)
    assert any("HDR" in sentence for sentence in done.warnings)
    index, pixels = _first(done)
    paper = shades[index] > 0.97
    if paper.any():
        assert 215 <= pixels[paper].mean() <= 248
    dark = shades[index] < 0.05
    assert pixels[dark].mean() < 40


def _sound(path: Path, walk: list[np.ndarray]) -> None:
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(8000)
        file.writeframes(bytes(16000))


def _noise(path: Path, walk: list[np.ndarray]) -> None:
    path.write_bytes(np.random.default_rng(0).bytes(50_000))


def _no_index(path: Path, walk: list[np.ndarray]) -> None:
    films.write(path, walk)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _encrypted(path: Path, walk: list[np.ndarray]) -> None:
    keys = {"encryption_key": "76a6c65c5ea762046bd749a2e632ccbb", "encryption_kid": "a7" * 16}
    films.write(path, walk, muxer={"encryption_scheme": "cenc-aes-ctr", **keys})


def _unknown_codec(path: Path, walk: list[np.ndarray]) -> None:
    films.write(path, walk)
    path.write_bytes(path.read_bytes().replace(b"avc1", b"zzzz"))


def _photo(path: Path, walk: list[np.ndarray]) -> None:
    Image.fromarray(walk[0]).save(path, "JPEG")


def _one_frame(path: Path, walk: list[np.ndarray]) -> None:
    films.write(path, walk[:1])


def _text(path: Path, walk: list[np.ndarray]) -> None:
    path.write_text("no video\n" * 200)


def _playlist(path: Path, walk: list[np.ndarray]) -> None:
    path.write_text("#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\nhttp://127.0.0.1:9/a.ts\n")


def _all_blurred(path: Path, walk: list[np.ndarray]) -> None:
    texture = films.wall(1200)
    films.write(path, (films.seen(texture, 8 * i, blur=1 if i == 20 else 60) for i in range(45)))


@pytest.mark.parametrize(
    ("name", "make", "says"),
    [
        ("sound.wav", _sound, "has no moving pictures, only audio"),
        ("noise.mp4", _noise, "cannot be opened as a video"),
        ("cut.mp4", _no_index, "an unfinished recording"),
        ("film.mp4", _encrypted, "is encrypted"),
        ("odd.mp4", _unknown_codec, "is not supported"),
        ("photo.mp4", _photo, "cannot be opened as a video"),
        ("one.mp4", _one_frame, "only one picture"),
        ("text.txt", _text, "cannot be opened as a video"),
        ("list.m3u8", _playlist, "cannot be opened as a video"),
        ("empty.mp4", lambda path, walk: path.write_bytes(b""), "is empty"),
        ("folder.mp4", lambda path, walk: path.mkdir(), "is a folder"),
        ("missing.mp4", lambda path, walk: None, "There is no video"),
    ],
)
def test_invalid_videos_are_refused(
    name: str,
    make: Callable[[Path, list[np.ndarray]], object],
    says: str,
    walk: list[np.ndarray],
    tmp_path: Path,
    capsys: Out,
) -> None:
    """Oracle: exit code 2, one sentence with the reason, and no files."""
    make(tmp_path / name, walk)
    assert main(["frames", str(tmp_path / name), "-o", str(tmp_path / "out"), "--quiet"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert says in said and "Traceback" not in said
    assert [p.name for p in tmp_path.iterdir()] == [name] * (name != "missing.mp4")


def test_a_video_cut_short_is_used_as_far_as_it_goes(tmp_path: Path) -> None:
    """Oracle: a file with its index at the beginning, cut in the middle of its pictures."""
    path = films.write(
        tmp_path / "cut.mp4", films.walk(120), options={"crf": "12", "g": "10"},
        muxer={"movflags": "+faststart"},
    )  # fmt: skip
    path.write_bytes(path.read_bytes()[: round(path.stat().st_size * 0.5)])
    done = _frames(path, tmp_path)
    assert 40 < done.total < 80
    assert any("cut short" in sentence for sentence in done.warnings)


def test_damaged_frames_are_left_out(tmp_path: Path) -> None:
    """Oracle: the original pictures: no chosen one shows the damage."""
    walk = films.walk(120)
    path = films.write(tmp_path / "hurt.mp4", walk, options={"crf": "12", "g": "10"})
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 3000] = np.random.default_rng(0).bytes(3000)
    path.write_bytes(bytes(data))
    done = _frames(path, tmp_path, count=12)
    assert any("damaged" in sentence for sentence in done.warnings)
    for name in done.names:
        pixels = np.asarray(Image.open(done.folder / name)).astype(int)
        near = min(
            np.abs(pixels - walk[i]).mean()
            for i in range(max(0, int(name[6:12]) - 1), min(120, int(name[6:12]) + 25))
        )
        assert near < 15

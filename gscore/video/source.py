"""Video source: a file opened with PyAV, its frames in display order, or an error."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

from ..errors import DatasetError, FormatError
from ..extras import need
from ..io.files import check_regular, is_file
from ..io.missing_path import missing_path
from ..quoting import brief
from ..text_format import count_text, number

_ENCRYPTED = ("encv", "drmi", "p608")
"""FourCC codes of encrypted streams, in place of the codec's."""
_CONTAINERS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpegtsraw,mpeg,mpegvideo,asf,flv,live_flv,mxf,"
    "ogg,gif,dv,h264,hevc,av1,ivf,obu,rm,nut,swf,vob,gxf,wtv,yuv4mpegpipe,wav,mp3,aac,flac,w64"
)
"""FFmpeg's formats that are self-contained files. Others are excluded, because playlists refer to
other files and addresses, and FFmpeg also reads text and photos as videos."""
_HDR = {16: "HDR (PQ)", 18: "HDR (HLG)"}
"""HDR transfer functions of ITU-T H.273."""
_LOOK = 12
"""Frames that are decoded to detect interlacing, which may start late."""
_DEINTERLACE = "bwdif"
_STRICT = ("h264", "hevc")
"""Decoders that must be configured to refuse damaged frames instead of concealing errors."""
_ODD = 0.05
"""Largest share of frames of another size that counts as damage; more are another video."""
_HOW = "Save it again with a program that plays it, as MP4 with H.264"


@dataclass(frozen=True, kw_only=True)
class VideoFacts:
    """Properties of a video from its metadata and first frames."""

    width: int
    """Pixels as stored."""
    height: int
    """Pixels as stored."""
    aspect: float
    """Width of a pixel over its height."""
    frames: int
    """Number of frames, stated or from length and rate; 0: unknown."""
    seconds: float
    """Stated duration; 0: unknown."""
    codec: str
    hdr: str
    """Kind of HDR; empty: none."""
    interlaced: bool
    orientation: tuple[int, int, int, int] = (1, 0, 0, 1)
    """Rotation and mirroring for display: a, b, c, d of -1, 0 or 1; the pixel at x, y from the
    middle moves to a x + c y, b x + d y."""

    @property
    def rotation(self) -> int:
        """Rotation to upright, degrees counter-clockwise: 0, 90, 180, 270; for mirrored frames,
        after mirroring left to right."""
        a, b, c, d = self.orientation
        mirror = a * d - b * c
        return {(1, 0): 0, (0, -1): 90, (-1, 0): 180, (0, 1): 270}[mirror * a, mirror * b]


class Video:
    """An open video; made by `opened_video`."""

    def __init__(self, path: Path, av: Any, container: Any, stream: Any) -> None:
        self._path, self._av, self._container, self._stream = path, av, container, stream
        self._encrypted = False
        self.damaged = 0
        """Number of packets and frames so far that could not be decoded completely."""
        self._decoded = self._decode()
        self._first = self._look()
        self.facts = self._facts()
        """Properties of the video."""

    def frames(self) -> Iterator[Any]:
        """Undamaged frames as av.VideoFrame, in display order; can be iterated once.

        Interlaced frames are deinterlaced to the time of the first field. Single frames of another
        size than the first count as damaged.

        Raises:
            DatasetError: after the last frame: many have another size.
        """
        frames = self._all()
        return _deinterlaced(self._av, frames) if self.facts.interlaced else frames

    def _all(self) -> Iterator[Any]:
        first, self._first = self._first, []
        size, count, odd = (self.facts.width, self.facts.height), 0, []
        for frame in chain(first, self._decoded):
            count += 1
            if (frame.width, frame.height) == size:
                yield frame
            else:
                odd.append((frame.width, frame.height))
        if len(odd) > _ODD * count:
            raise self._joined(odd[-1], count - len(odd))
        self.damaged += len(odd)

    def _joined(self, size: tuple[int, int], before: int) -> DatasetError:
        facts = self.facts
        return DatasetError(
            f"{brief(self._path)} joins videos of two sizes: {count_text(before, 'frame')} of "
            f"{facts.width} x {facts.height} px, others of {size[0]} x {size[1]} px. Split it "
            "into files of one size, extract the frames of each, and give gscore sfm their folders."
        )

    def _look(self) -> list[Any]:
        first = []
        for frame in self._decoded:
            first.append(frame)
            if len(first) == _LOOK:
                break
        if not first and self._encrypted:
            raise _encrypted(self._path)
        if not first:
            raise FormatError(
                f"No frame of {brief(self._path)} can be decoded: it is damaged or cut short. "
                f"{_HOW}, or copy it from the camera again."
            )
        if len(first) == 1 and self._stream.frames > 1:
            raise FormatError(
                f"{brief(self._path)} states {number(self._stream.frames)} frames, but only one is "
                f"displayed: its time base or edit list is damaged. {_HOW}."
            )
        if len(first) == 1:
            raise DatasetError(
                f"{brief(self._path)} has only one picture, a video was expected. Put photos into "
                "a separate folder."
            )
        return first

    def _decode(self) -> Iterator[Any]:
        """Frames without damaged ones, which last up to the next key frame."""
        waiting = False
        for packet in self._packets():
            try:
                frames = packet.decode()
            except self._av.error.FFmpegError:
                self._encrypted |= packet.has_sidedata("encryption_info")
                self.damaged += 1
                waiting = True
                continue
            for frame in frames:
                waiting = frame.is_corrupt or (waiting and not frame.key_frame)
                if waiting:
                    self.damaged += 1
                else:
                    yield frame

    def _packets(self) -> Iterator[Any]:
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets)
            except StopIteration:
                return
            except self._av.error.FFmpegError:  # the file is truncated
                self.damaged += 1
                return
            except IndexError:  # from PyAV, for a bogus stream due to damage; reading is restarted
                self.damaged += 1
                packets = self._container.demux(self._stream)
                continue
            yield packet

    def _facts(self) -> VideoFacts:
        stream, frame = self._stream, self._first[0]
        ratio = stream.sample_aspect_ratio or stream.codec_context.sample_aspect_ratio
        seconds = float(stream.duration * stream.time_base) if stream.duration else 0.0
        if not seconds and self._container.duration:
            seconds = self._container.duration / self._av.time_base
        count = stream.frames or round(seconds * float(stream.average_rate or 0))
        return VideoFacts(
            width=frame.width,
            height=frame.height,
            aspect=float(ratio) if ratio else 1.0,
            frames=count,
            seconds=seconds,
            codec=stream.codec_context.name,
            hdr=_HDR.get(frame.color_trc, ""),
            interlaced=any(frame.interlaced_frame for frame in self._first),
            orientation=_orientation(frame),
        )


def _orientation(frame: Any) -> tuple[int, int, int, int]:
    """Orientation from a frame's display matrix (ISO 14496-12, 6.2.2), rounded to quarter turns;
    upright without a matrix or with a singular one."""
    stated = frame.side_data.get("DISPLAYMATRIX")
    if stated is None:
        return 1, 0, 0, 1
    a, b, _, c, d, *_ = (float(value) for value in memoryview(bytes(stated)).cast("i"))
    if a * d == b * c:
        return 1, 0, 0, 1
    if abs(a * d) >= abs(b * c):
        return _sign(a), 0, 0, _sign(d)
    return 0, _sign(b), _sign(c), 0


def _sign(value: float) -> int:
    return 1 if value > 0 else -1


@contextmanager
def opened_video(path: Path) -> Iterator[Video]:
    """Open a video; it is closed at the end of the block.

    Raises:
        BackendError: PyAV is not installed.
        DatasetError: there is no such file, or it has no video stream.
        FormatError: it is not a video, damaged, encrypted or of an unsupported codec.
    """
    av = need("av", "Reading a video")
    if not path.exists():
        raise DatasetError(missing_path(path, "video"))
    check_regular(path)
    try:
        options = {"protocol_whitelist": "file", "format_whitelist": _CONTAINERS}
        container = av.open(f"file:{path}", options=options, **_metadata_errors(av))
    except PermissionError as error:
        raise DatasetError(f"Cannot read {brief(path)}: permission denied.") from error
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise FormatError(_why_not_opened(path)) from error
    with container:
        yield Video(path, av, container, _stream(path, container))


def _metadata_errors(av: Any) -> dict[str, str]:
    """The argument that keeps PyAV before 19 from failing on metadata that is not UTF-8; later ones
    never fail and have no such argument."""
    return {"metadata_errors": "replace"} if int(av.__version__.split(".")[0]) < 19 else {}


def _why_not_opened(path: Path) -> str:
    if is_file(path) and path.stat().st_size == 0:
        return f"{brief(path)} is empty. Copy it from the camera again."
    return (
        f"{brief(path)} cannot be opened as a video: it is none, damaged, or an unfinished "
        f"recording. {_HOW}, or repair it with the camera's program."
    )


def _stream(path: Path, container: Any) -> Any:
    """The video stream.

    Raises:
        DatasetError: there is none.
        FormatError: it is encrypted, or of an unsupported codec.
    """
    best = container.streams.best("video")
    if best is None:
        kinds = sorted({stream.type for stream in container.streams})
        has = f", only {' and '.join(kinds)}" if kinds else ""
        raise DatasetError(
            f"{brief(path)} has no moving pictures{has}. Give the file of the video itself."
        )
    context = best.codec_context
    tag = getattr(context, "codec_tag", "")
    if tag in _ENCRYPTED:
        raise _encrypted(path)
    if context is None or not context.is_decoder:
        raise FormatError(
            f"The codec of the video {brief(path)} is not supported ({tag or 'unknown'}). {_HOW}."
        )
    if context.name in _STRICT:
        context.options = {"err_detect": "explode"}
    best.thread_type = "AUTO"
    return best


def _encrypted(path: Path) -> FormatError:
    return FormatError(
        f"{brief(path)} is encrypted (DRM), so its pictures cannot be read. Use your own recording."
    )


def damage_text(video: Video, last: float) -> str:
    """Warning about damaged frames or a missing end; empty without any.

    Args:
        video: The video, after all of its frames were read.
        last: Time of the last undamaged frame, s.
    """
    stated = video.facts.seconds
    if stated and last < 0.95 * stated - 1.0:
        return (
            f"The video states {stated:.1f} s but its frames end at {last:.1f} s: it was cut "
            "short. The existing frames are used."
        )
    if video.damaged:
        return f"{count_text(video.damaged, 'damaged frame')} left out."
    return ""


def _deinterlaced(av: Any, frames: Iterator[Any]) -> Iterator[Any]:
    """Deinterlaced frames, at the time of their first field."""
    graph = None
    for frame in frames:
        if graph is None:
            graph = _graph(av, frame)
        graph.vpush(frame)
        yield from _pulled(av, graph)
    if graph is not None:
        graph.vpush(None)
        yield from _pulled(av, graph)


def _graph(av: Any, frame: Any) -> Any:
    from av.filter import Graph

    graph = Graph()
    source = graph.add_buffer(
        width=frame.width,
        height=frame.height,
        format=frame.format,
        time_base=frame.time_base,
    )
    nodes = [source, graph.add(_DEINTERLACE, "mode=send_frame"), graph.add("buffersink")]
    for before, after in pairwise(nodes):
        before.link_to(after)
    graph.configure()
    return graph


def _pulled(av: Any, graph: Any) -> Iterator[Any]:
    while True:
        try:
            yield graph.vpull()
        except (av.error.BlockingIOError, av.error.EOFError):
            return

"""Memory shared by threads that decode photos; oracles: counters, and the kernel's count."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.datasets.dataset import Dataset
from gscore.datasets.decode import DECODED_AT_ONCE, ViewFile, _Room, decode_view
from gscore.io.images.read_image import read_image
from tests.fuzz.test_readers import peak_bytes


def file_of(path: Path, size: tuple[int, int], to: tuple[int, int]) -> ViewFile:
    """A photo without mask or distortion."""
    return ViewFile(
        image=path,
        mask=None,
        mask_inverted=False,
        use_alpha=False,
        upright=False,
        photo_size=size,
        size=to,
        plan=None,
    )


@pytest.mark.parametrize(("size", "together"), [(3, 3), (5, 2), (6, 1), (25, 1)])
def test_no_more_than_there_is(size: int, together: int) -> None:
    """Oracle: a counter of active threads, of eight; a photo larger than the whole room is
    alone."""
    room, lock, full = _Room(10), threading.Lock(), threading.Event()
    inside, most = 0, 0

    def work() -> None:
        nonlocal inside, most
        with room.take(size):
            with lock:
                inside += 1
                most = max(most, inside)
                if inside == together:
                    full.set()
            assert full.wait(60)
            time.sleep(0.02)  # for others that may not enter
            with lock:
                inside -= 1

    with ThreadPoolExecutor(8) as pool:
        for future in [pool.submit(work) for _ in range(16)]:
            future.result(timeout=20)
    assert most == together


def test_memory_of_parallel_decoding(tmp_path: Path) -> None:
    """Oracle: by hand: photos of 100 megapixels one by one, small ones a thread each."""
    large = file_of(tmp_path / "a.jpg", (12_000, 9_000), (400, 300))
    small = file_of(tmp_path / "b.jpg", (1200, 900), (400, 300))

    def of(*files: ViewFile) -> Dataset:
        return Dataset(
            scene=None,  # type: ignore[arg-type]
            files=list(files),
            train=[],
            test=[],
            mask_mode="none",
            source=tmp_path,
        )

    assert of(small, large).decoding_bytes(16) == large.decoding_bytes < DECODED_AT_ONCE
    assert of(small, small).decoding_bytes(4) == 4 * small.decoding_bytes
    assert of().decoding_bytes(4) == 0


@pytest.mark.parametrize("mode", ["RGB", "L", "P", "RGBA", "CMYK", "I;16"])
def test_strips_are_the_whole(mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: Pillow's conversion of the whole picture."""
    values = np.random.default_rng(0).integers(0, 256, (37, 29, 3)).astype(np.uint8)
    path = tmp_path / ("a.tif" if mode in ("CMYK", "I;16") else "a.png")
    if mode == "I;16":
        Image.fromarray(values[..., 0].astype(np.uint16) * 257).save(path)
        expected = values[..., :1].repeat(3, axis=2)
    else:
        picture = Image.fromarray(values).convert(mode)
        if mode == "RGBA":
            picture.putalpha(Image.fromarray(values[..., 0]))
        picture.save(path)
        expected = np.array(picture.convert("RGBA" if mode == "RGBA" else "RGB"))
    monkeypatch.setattr("gscore.io.images.pixels._PIXELS_A_STRIP", 100)
    np.testing.assert_array_equal(read_image(path), expected)


def test_memory_of_a_large_photo(tmp_path: Path) -> None:
    """Oracle: the kernel's count while 40 megapixels are read, at most the estimate."""
    path, size = tmp_path / "a.jpg", (8000, 5000)
    Image.new("RGB", size, (90, 120, 30)).save(path)
    file = file_of(path, size, (400, 250))
    decode_view(file_of(path, size, size))  # loads one-time modules
    before = peak_bytes(restart=True)
    if not before:
        pytest.skip("the system does not tell")
    decode_view(file)
    grew = peak_bytes(restart=False) - before
    assert 4 * 40e6 < grew < 1.1 * file.decoding_bytes

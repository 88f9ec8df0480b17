"""Captures on disk; oracle: the data that they were made from."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gscore.config import DataConfig
from gscore.datasets import Dataset, load_dataset
from gscore.datasets.resolution import target_size
from gscore.errors import BackendError, Cancelled, ConfigError, DatasetError, FormatError, GsError
from gscore.io.colmap.folder import ColmapPoints, read_model, write_model
from gscore.io.images.png import write_png
from gscore.io.images.read_image import read_image


def _load(root: Path, **options: Any) -> Dataset:
    return load_dataset(DataConfig(source=root, **options))


def test_plain_capture(make_capture: Callable) -> None:
    """Oracle: the written model and photos."""
    capture = make_capture()
    data = _load(capture.root)
    cameras = data.scene.cameras
    assert len(data) == 9 and data.names == tuple(sorted(capture.photos))
    assert data.warnings == () and data.mask_mode == "none" and data.source == capture.root
    assert (data.train, data.test) == (list(range(9)), [])
    assert (cameras.widths.tolist(), cameras.heights.tolist()) == ([64] * 9, [48] * 9)
    for i, image in enumerate(capture.model.images):
        np.testing.assert_allclose(cameras.viewmats[i], image.viewmat, atol=1e-15)
        np.testing.assert_array_equal(cameras.Ks[i], capture.model.cameras[1].K)
        np.testing.assert_array_equal(data.image(i), capture.photos[image.name])
        assert data.mask(i) is None and data.image(i).flags.c_contiguous
    np.testing.assert_array_equal(data.scene.points.points, capture.model.points.xyz)
    np.testing.assert_array_equal(data.scene.points.colors, capture.model.points.rgb)
    assert data.nbytes == 9 * 64 * 48 * 3


def test_sorted_by_name_with_subfolders(make_capture: Callable) -> None:
    """Oracle: names sorted as text, photos and poses following."""
    names = ["b/2.png", "a/9.png", "z.png", "a/10.png"]
    capture = make_capture(names=names)
    data = _load(capture.root, eval=True, test_last=1)
    assert data.names == ("a/10.png", "a/9.png", "b/2.png", "z.png")
    assert (data.train, data.test) == ([0, 1, 2], [3])
    by_name = {image.name: image for image in capture.model.images}
    for i, name in enumerate(data.names):
        np.testing.assert_allclose(
            data.scene.cameras.viewmats[i], by_name[name].viewmat, atol=1e-15
        )
        np.testing.assert_array_equal(data.image(i), capture.photos[name])


@pytest.mark.parametrize(
    ("size", "resolution", "expected"),
    [
        ((800, 600), -1, (800, 600)),
        ((1600, 9), -1, (1600, 9)),
        ((4000, 3000), -1, (1600, 1200)),
        ((1237, 822), 1, (1237, 822)),
        ((1237, 822), 2, (618, 411)),
        ((1237, 822), 4, (309, 206)),
        ((1237, 822), 8, (155, 103)),
        ((1237, 822), 2.5, (495, 329)),
        ((1237, 822), 400, (400, 266)),
        ((300, 200), 400, (300, 200)),
        ((5, 3), 8, (1, 1)),
    ],
)
def test_target_sizes(size: tuple[int, int], resolution: float, expected: tuple[int, int]) -> None:
    """Oracle: the documented meaning of -r, computed by hand."""
    assert target_size(*size, resolution, max_width=1600) == expected


def test_largest_width(make_capture: Callable) -> None:
    """Oracle: the width of the option without -r; unscaled photos with it."""
    root = make_capture(size=(101, 67)).root
    assert _load(root, max_width=40).image(0).shape == (27, 40, 3)
    assert _load(root, max_width=40, resolution=1).image(0).shape == (67, 101, 3)
    with pytest.raises(ConfigError, match="max_width is 0"):
        _load(root, max_width=0)


@pytest.mark.parametrize("resolution", [0, -2, 0.5, 9, 15, float("nan"), float("inf")])
def test_unusable_resolutions(resolution: float, make_capture: Callable) -> None:
    """Oracle: the sentence, with the values of -r."""
    with pytest.raises(ConfigError, match=r"resolution is .*; expected -1"):
        _load(make_capture().root, resolution=resolution)


@pytest.mark.parametrize("resolution", [1, 2, 2.5, 4, 40])
def test_scaled_cameras_see_the_same(resolution: float, make_capture: Callable) -> None:
    """Oracle: the same fraction of the picture for a projected point, on each axis separately."""
    capture = make_capture(size=(101, 67))
    full, small = _load(capture.root), _load(capture.root, resolution=resolution)
    sizes = [np.stack([d.scene.cameras.widths, d.scene.cameras.heights], 1) for d in (full, small)]
    for point in capture.model.points.xyz:
        places = []
        for data, size in zip((full, small), sizes, strict=True):
            cameras = data.scene.cameras
            in_camera = cameras.viewmats[:, :3, :3] @ point + cameras.viewmats[:, :3, 3]
            pixels = np.einsum("cij,cj->ci", cameras.Ks, in_camera)
            places.append(pixels[:, :2] / pixels[:, 2:] / size)
        np.testing.assert_allclose(places[0], places[1], rtol=1e-12)
    for i in range(len(small)):
        assert small.image(i).shape == (sizes[1][i, 1], sizes[1][i, 0], 3)
        mean = small.image(i).mean(axis=(0, 1)) - full.image(i).mean(axis=(0, 1))
        assert np.abs(mean).max() < 1.0


def test_photos_of_another_size(make_capture: Callable) -> None:
    """Oracle: photos of half the size give half the intrinsics, and a warning."""
    capture = make_capture(size=(101, 67))
    for name, photo in capture.photos.items():
        small = Image.fromarray(photo).resize((50, 33), Image.Resampling.BOX)
        (capture.root / "images_2").mkdir(exist_ok=True)
        small.save(capture.root / "images_2" / name)
    data = _load(capture.root, images="images_2")
    np.testing.assert_allclose(
        data.scene.cameras.Ks[0], np.diag([50 / 101, 33 / 67, 1]) @ capture.model.cameras[1].K
    )
    assert data.image(0).shape == (33, 50, 3)
    (warning,) = data.warnings
    assert "9 photos have another size than the camera" in warning
    assert "view_00.png (50 x 33 for 101 x 67)" in warning


def test_photos_of_another_shape(make_capture: Callable) -> None:
    """Oracle: the refusal of a cropped photo, with both sizes."""
    capture = make_capture()
    write_png(capture.root / "images" / "view_03.png", np.zeros((48, 40, 3), np.uint8))
    with pytest.raises(DatasetError, match=r"view_03\.png is 40 x 48 pixels, .* for 64 x 48"):
        _load(capture.root)


def test_photos_turned_by_exif(make_capture: Callable) -> None:
    """Oracle: a model made from upright photos, while the files are stored sideways."""
    capture = make_capture(names=[f"{i}.jpg" for i in range(3)], write=False)
    exif = Image.Exif()
    exif[0x0112] = 6  # to show, turn clockwise: the file has the upright picture turned back
    for name, photo in capture.photos.items():
        (capture.root / "images").mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.ascontiguousarray(np.rot90(photo, 1))).save(
            capture.root / "images" / name, exif=exif, quality=100, subsampling=0
        )
    write_model(capture.model, capture.root / "sparse")
    data = _load(capture.root)
    for i, name in enumerate(data.names):
        assert np.abs(data.image(i).astype(int) - capture.photos[name]).mean() < 2


@pytest.mark.parametrize("ending", ["jpg", "webp"])  # read with and without Pillow
def test_photos_turned_by_exif_without_a_trace_in_their_size(
    ending: str, make_capture: Callable
) -> None:
    """Oracle: pixels as stored, and a warning: upside down, and square photos on their side."""
    for size, orientation, messages in (
        ((64, 48), 3, True),
        ((48, 48), 6, True),
        ((64, 48), 1, False),
    ):
        names = [f"{i}.{ending}" for i in range(3)]
        root = make_capture().root.parent / f"turned_{orientation}"
        capture = make_capture(root=root, names=names, size=size, write=False)
        (root / "images").mkdir(parents=True)
        exif = Image.Exif()
        exif[0x0112] = orientation
        for name, photo in capture.photos.items():
            Image.fromarray(photo).save(root / "images" / name, exif=exif, quality=100)
        write_model(capture.model, root / "sparse")
        data = _load(root)
        for i, name in enumerate(data.names):
            assert np.abs(data.image(i).astype(int) - capture.photos[name]).mean() < 2
        assert bool(data.warnings) == messages
        if messages:
            assert data.warnings[0].startswith(
                f"The EXIF rotation of 3 photos is ignored, as in COLMAP: 0.{ending}, 1.{ending}"
            )


def test_duplicate_photos_warn(make_capture: Callable) -> None:
    """Oracle: two copies of one photo, one of them under another ending; none in other captures."""
    capture = make_capture()
    images = capture.root / "images"
    for copy in ("view_03.png", "view_05.png"):
        (images / copy).write_bytes((images / "view_01.png").read_bytes())
    (warning,) = _load(capture.root).warnings
    assert warning.startswith(
        "2 photos are copies of others: view_03.png of view_01.png, view_05.png of view_01.png."
    )


class TestMissing:
    """Missing photos and folders."""

    def test_some_photos(self, make_capture: Callable) -> None:
        """Oracle: the others, in order, with a warning that names the missing."""
        capture = make_capture()
        for i in (1, 4):
            (capture.root / "images" / f"view_{i:02d}.png").unlink()
        data = _load(capture.root)
        assert len(data) == 7
        (warning,) = data.warnings
        assert "2 of the 9 images" in warning and "view_01.png, view_04.png" in warning
        np.testing.assert_array_equal(data.image(1), capture.photos["view_02.png"])

    def test_most_photos(self, make_capture: Callable) -> None:
        """Oracle: the error lists the first few names and the folder."""
        capture = make_capture()
        for i in range(1, 9):
            (capture.root / "images" / f"view_{i:02d}.png").unlink()
        with pytest.raises(DatasetError) as caught:
            _load(capture.root)
        message = str(caught.value)
        assert "8 of the 9 images" in message and "view_01.png" in message
        assert "view_05.png and 3 more" in message and str(capture.root / "images") in message
        assert "--images" in message

    def test_folders(self, make_capture: Callable, tmp_path: Path) -> None:
        """Oracle: the sentence, with the folder and the option."""
        capture = make_capture()
        with pytest.raises(DatasetError, match=r"no image folder .*photos.*--images"):
            _load(capture.root, images="photos")
        with pytest.raises(DatasetError, match="There is no folder"):
            _load(tmp_path / "nowhere")
        (tmp_path / "empty").mkdir()
        with pytest.raises(DatasetError, match="is an empty folder"):
            _load(tmp_path / "empty")
        (tmp_path / "empty" / "notes.txt").touch()
        with pytest.raises(DatasetError, match=r"There are no photos in .* or its folders"):
            _load(tmp_path / "empty")
        (tmp_path / "empty" / "images").mkdir()
        (tmp_path / "empty" / "images" / "notes.txt").touch()
        with pytest.raises(DatasetError, match=r"There are no photos in .*empty/images\."):
            _load(tmp_path / "empty")

    def test_other_ending_or_case(self, make_capture: Callable) -> None:
        """Oracle: photos converted to another format or renamed by case, found and reported."""
        capture = make_capture(names=["a.JPG", "Sub/b.jpg", "c.png"], write=False)
        write_model(capture.model, capture.root / "sparse" / "0")
        files = {"a.JPG": "a.png", "Sub/b.jpg": "sub/B.png", "c.png": "c.png"}
        for name, file in files.items():
            write_png(capture.root / "images" / file, capture.photos[name])
        data = _load(capture.root)
        for i, name in enumerate(data.names):
            np.testing.assert_array_equal(data.image(i), capture.photos[name])
        (warning,) = data.warnings
        assert "2 images are named differently" in warning and "a.JPG -> a.png" in warning

    def test_model_without_images(self, make_capture: Callable) -> None:
        """Oracle: the refusal of an empty model."""
        capture = make_capture(write=False)
        write_model(replace(capture.model, images=[]), capture.root)
        with pytest.raises(DatasetError, match="has no images"):
            _load(capture.root)

    def test_names_used_twice(self, make_capture: Callable) -> None:
        """Oracle: the sentence lists them."""
        capture = make_capture(write=False)
        images = [replace(image, name="same.png") for image in capture.model.images]
        write_model(replace(capture.model, images=images), capture.root)
        with pytest.raises(DatasetError, match=r"several images of the same name: same\.png"):
            _load(capture.root)


class TestDecoding:
    """Decoding of photos: when it happens, and errors of broken ones."""

    def test_once_and_lazily(self, make_capture: Callable, monkeypatch: Any) -> None:
        """Oracle: a count of calls; loading decodes nothing, preloading each photo once."""
        from gscore.datasets import decode

        seen: list[Path] = []

        def count(path: Path, **options: Any) -> np.ndarray:
            seen.append(path)
            return read_image(path, **options)

        monkeypatch.setattr(decode, "read_image", count)
        data = _load(make_capture().root)
        assert seen == []
        progress: list[tuple[int, int]] = []
        data.preload(threads=3, on_progress=lambda done, total: progress.append((done, total)))
        assert progress == [(k, 9) for k in range(1, 10)]
        first = data.image(4)
        data.preload()
        assert len(seen) == 9 and data.image(4) is first
        assert sum(data.image(i).nbytes for i in range(9)) == data.nbytes

    def test_threads_agree(self, make_capture: Callable) -> None:
        """Oracle: the photos; the same bytes for many threads at the same time."""
        capture = make_capture()
        data = _load(capture.root)
        results: list[list[np.ndarray]] = []

        def ask() -> None:
            results.append([data.image(i) for i in range(9)])

        threads = [threading.Thread(target=ask) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(results) == 8
        for images in results:
            for image, again in zip(images, results[0], strict=True):
                np.testing.assert_array_equal(image, again)

    def test_part(self, make_capture: Callable) -> None:
        """Oracle: reports about the requested views only."""
        data = _load(make_capture().root)
        done: list[int] = []
        data.preload([2, 5], on_progress=lambda k, total: done.append(total))
        assert done == [2, 2]

    def test_cancel(self, make_capture: Callable) -> None:
        """Oracle: a stop at the first check."""
        data = _load(make_capture().root)
        with pytest.raises(Cancelled):
            data.preload(cancelled=lambda: True)

    @pytest.mark.parametrize("threads", [1, 3])
    def test_truncated_photo(self, threads: int, make_capture: Callable) -> None:
        """Oracle: the error names the file."""
        capture = make_capture()
        path = capture.root / "images" / "view_06.png"
        path.write_bytes(path.read_bytes()[:-40])
        data = _load(capture.root)
        with pytest.raises(FormatError, match=r"view_06\.png cannot be read as an image"):
            data.preload(threads=threads)

    def test_photo_that_is_none(self, make_capture: Callable) -> None:
        """Oracle: an error before any decoding."""
        capture = make_capture()
        (capture.root / "images" / "view_02.png").write_bytes(b"")
        with pytest.raises(FormatError, match=r"view_02\.png cannot be read as an image"):
            _load(capture.root)

    def test_too_little_memory(self, make_capture: Callable, monkeypatch: Any) -> None:
        """Oracle: an allocation that fails while a photo is scaled: its name and size are
        reported."""
        data = _load(make_capture().root)

        def fails(*_: Any, **__: Any) -> None:
            raise MemoryError

        monkeypatch.setattr("gscore.datasets.decode.resize", fails)
        with pytest.raises(
            BackendError, match=r"Out of memory while .*view_04\.png, 64 x 48 pixels"
        ):
            data.image(4)

    def test_photo_that_changes(self, make_capture: Callable) -> None:
        """Oracle: the sentence gives both sizes."""
        capture = make_capture()
        data = _load(capture.root)
        write_png(capture.root / "images" / "view_00.png", np.zeros((9, 9, 3), np.uint8))
        with pytest.raises(FormatError, match=r"is 9 x 9 pixels, expected 64 x 48; it changed"):
            data.image(0)


class TestMasks:
    """Alpha, mask folders and their modes."""

    def _masks(self, root: Path, naming: str, count: int = 9, folder: str = "masks") -> None:
        for i in range(count):
            mask = np.zeros((48, 64), np.uint8)
            mask[:, i:] = 255
            mask[:3] = 100
            write_png(root / folder / naming.format(f"view_{i:02d}"), mask)

    @pytest.mark.parametrize("naming", ["{}.png", "{}.png.png", "{}.PNG"])
    def test_folder(self, naming: str, make_capture: Callable) -> None:
        """Oracle: the written masks, with soft values; both naming conventions."""
        capture = make_capture()
        self._masks(capture.root, naming)
        data = _load(capture.root)
        assert data.mask_mode == "ignore" and data.warnings == ()
        mask = data.mask(5)
        assert mask is not None and mask.flags.c_contiguous
        assert (mask[:3] == 100).all() and not mask[3:, :5].any() and (mask[3:, 5:] == 255).all()
        np.testing.assert_array_equal(data.image(5), capture.photos["view_05.png"])
        assert data.nbytes == 9 * 64 * 48 * 4

    def test_inverted_masks(self, make_capture: Callable) -> None:
        """Oracle: 255 minus the masks as read; the mode is ignore unless the option sets it."""
        capture = make_capture()
        self._masks(capture.root, "{}.png")
        usual = _load(capture.root)
        data = _load(capture.root, invert_masks=True)
        assert data.mask_mode == "ignore" and data.warnings == ()
        for index in range(len(data)):
            mask, other = usual.mask(index), data.mask(index)
            assert mask is not None and other is not None
            np.testing.assert_array_equal(other, 255 - mask)
        assert data.content_hash() != usual.content_hash()
        composite = _load(capture.root, invert_masks=True, mask_mode="composite")
        assert composite.mask_mode == "composite"

    def test_no_mask_files_to_invert(self, make_capture: Callable) -> None:
        """Oracle: the alpha as written, and a warning."""
        capture = make_capture(alpha=True)
        data = _load(capture.root, invert_masks=True)
        assert data.warnings == ("There are no mask files, so invert_masks changes nothing.",)
        np.testing.assert_array_equal(data.mask(2), capture.photos["view_02.png"][..., 3])

    @pytest.mark.parametrize("mode", ["composite", "ignore"])
    def test_a_mode_without_masks_changes_nothing(self, mode: str, make_capture: Callable) -> None:
        """Oracle: a warning that names the option; none for `auto` and with alpha."""
        root = make_capture().root
        data = _load(root, mask_mode=mode)
        assert data.mask_mode == "none"
        (text,) = data.warnings
        assert text.startswith(f"`--mask-mode {mode}` changes nothing: there are no mask files")
        assert _load(root).warnings == ()

    def test_a_mode_with_alpha_has_an_effect(self, make_capture: Callable) -> None:
        data = _load(make_capture(alpha=True).root, mask_mode="ignore")
        assert data.mask_mode == "ignore" and data.warnings == ()

    def test_alpha(self, make_capture: Callable) -> None:
        """Oracle: colours and alpha as written."""
        capture = make_capture(alpha=True)
        data = _load(capture.root)
        assert data.mask_mode == "composite"
        photo = capture.photos["view_02.png"]
        mask = data.mask(2)
        assert mask is not None
        np.testing.assert_array_equal(mask, photo[..., 3])
        np.testing.assert_array_equal(data.image(2), photo[..., :3])

    @pytest.mark.parametrize("least", [255, 254, 128])
    @pytest.mark.parametrize("mode", ["auto", "composite", "ignore"])
    def test_alpha_that_hides_nothing_is_no_mask(
        self, mode: str, least: int, make_capture: Callable
    ) -> None:
        """Oracle: the same capture without alpha: mode, bytes, photos."""
        capture = make_capture()
        plain = _load(capture.root, mask_mode=mode)
        plain.preload()
        for name, photo in capture.photos.items():
            opaque = np.dstack([photo, np.full(photo.shape[:2], 255, np.uint8)])
            opaque[5:9, 6, 3] = least
            write_png(capture.root / "images" / name, opaque)
        data = _load(capture.root, mask_mode=mode)
        assert data.mask_mode == plain.mask_mode == "none"
        assert data.nbytes == plain.nbytes
        for i in range(len(data)):
            assert data.mask(i) is None
            np.testing.assert_array_equal(data.image(i), plain.image(i))

    def test_the_last_photo_alone_may_hide_something(self, make_capture: Callable) -> None:
        """Oracle: one pixel of the last of nine photos."""
        capture = make_capture()
        for k, (name, photo) in enumerate(capture.photos.items()):
            rgba = np.dstack([photo, np.full(photo.shape[:2], 255, np.uint8)])
            rgba[5, 6, 3] = 127 if k == 8 else 255
            write_png(capture.root / "images" / name, rgba)
        data = _load(capture.root)
        assert data.mask_mode == "composite" and data.mask(0) is None
        mask = data.mask(8)
        assert mask is not None and mask[5, 6] == 127
        with pytest.raises(Cancelled):
            load_dataset(
                DataConfig(source=capture.root), cancelled=iter([False] * 9 + [True]).__next__
            )

    def test_labels_are_masks(self, make_capture: Callable) -> None:
        """Oracle: 0 and 1 in 16 bits as yes and no, and a sentence about this assumption."""
        capture = make_capture()
        labels = np.zeros((48, 64), np.uint16)
        labels[:, 20:] = 1
        for name in capture.photos:
            write_png(capture.root / "masks" / name, labels)
        data = _load(capture.root)
        mask = data.mask(2)
        assert mask is not None
        np.testing.assert_array_equal(mask, labels * 255)
        (warning,) = data.warnings
        assert warning.startswith("The masks contain only 0 and 1; 1 is read as white, for example")
        assert "view_00.png" in warning

    def test_opaque_alpha_is_no_mask(self, make_capture: Callable) -> None:
        """Oracle: a photo whose alpha is 255 everywhere."""
        capture = make_capture(alpha=True)
        photo = capture.photos["view_02.png"].copy()
        photo[..., 3] = 255
        write_png(capture.root / "images" / "view_02.png", photo)
        data = _load(capture.root)
        assert data.mask(2) is None and data.mask(3) is not None
        assert data.nbytes >= sum(
            data.image(i).nbytes + (0 if data.mask(i) is None else data.mask(i).nbytes)  # type: ignore[union-attr]
            for i in range(9)
        )

    @pytest.mark.parametrize(
        ("alpha", "folder", "mode", "expected", "has_mask"),
        [
            (True, False, "auto", "composite", True),
            (True, False, "ignore", "ignore", True),
            (True, False, "none", "none", False),
            (True, True, "auto", "ignore", True),
            (False, True, "composite", "composite", True),
            (False, True, "none", "none", False),
            (False, False, "composite", "none", False),
        ],
    )
    def test_modes(
        self,
        alpha: bool,
        folder: bool,
        mode: str,
        expected: str,
        has_mask: bool,
        make_capture: Callable,
    ) -> None:
        """Oracle: the documented table; a folder has precedence over alpha."""
        capture = make_capture(alpha=alpha)
        if folder:
            self._masks(capture.root, "{}.png")
        data = _load(capture.root, mask_mode=mode)
        assert data.mask_mode == expected
        mask = data.mask(4)
        assert (mask is not None) == has_mask
        if folder and mask is not None:
            assert mask[10, 3] == 0 and mask[10, 4] == 255

    def test_scaled_with_the_photo(self, make_capture: Callable) -> None:
        """Oracle: area means; pixels cut in half are half kept."""
        capture = make_capture()
        self._masks(capture.root, "{}.png")
        mask = _load(capture.root, resolution=2).mask(5)
        assert mask is not None and mask.shape == (24, 32)
        assert mask[10, :4].tolist() == [0, 0, 128, 255]

    def test_other_folder(self, make_capture: Callable) -> None:
        """Oracle: the folder of the option; a missing or foreign one is refused."""
        capture = make_capture()
        self._masks(capture.root, "{}.png", folder="mattes")
        assert _load(capture.root).mask_mode == "none"
        assert _load(capture.root, masks="mattes").mask_mode == "ignore"
        with pytest.raises(DatasetError, match=r"no mask folder .*gone"):
            _load(capture.root, masks="gone")
        write_png(capture.root / "other" / "x.png", np.zeros((2, 2), np.uint8))
        with pytest.raises(DatasetError, match=r"has no mask of any view.*view_00\.png\.png"):
            _load(capture.root, masks="other")
        write_png(capture.root / "masks" / "x.png", np.zeros((2, 2), np.uint8))
        data = _load(capture.root)
        assert data.mask_mode == "none" and "It is not used" in data.warnings[0]

    def test_some_missing(self, make_capture: Callable) -> None:
        """Oracle: full views without a mask, with a warning."""
        capture = make_capture()
        self._masks(capture.root, "{}.png", count=7)
        data = _load(capture.root)
        assert data.mask(8) is None and data.mask(6) is not None
        assert "2 of 9 views have no mask" in data.warnings[0]

    def test_other_size(self, make_capture: Callable) -> None:
        """Oracle: the error names the file and both sizes, before anything is decoded."""
        capture = make_capture()
        self._masks(capture.root, "{}.png")
        write_png(capture.root / "masks" / "view_04.png", np.zeros((24, 32), np.uint8))
        with pytest.raises(DatasetError, match=r"view_04\.png is 32 x 24 pixels, .* is 64 x 48"):
            _load(capture.root)

    def test_unknown_mode(self, make_capture: Callable) -> None:
        """Oracle: the sentence lists the values."""
        with pytest.raises(ConfigError, match="must be one of auto, composite, ignore, none"):
            _load(make_capture().root, mask_mode="invert")


class TestPoints:
    """Points repaired while loading."""

    @pytest.mark.parametrize("known", [True, False])
    def test_black_points_are_colored(self, known: bool, make_capture: Callable) -> None:
        """Oracle: the colours of the discs drawn for the points in the photos."""
        capture = make_capture(black=True, views=12)
        if not known:  # without observations every photo is searched
            images = [
                replace(image, point3D_ids=np.full_like(image.point3D_ids, -1))
                for image in capture.model.images
            ]
            write_model(replace(capture.model, images=images), capture.root / "sparse" / "0")
        data = _load(capture.root)
        assert "All points are black (6 of them" in data.warnings[0]
        points = capture.model.points.xyz
        expected = np.zeros((6, 3))
        number = np.zeros(6)
        for i, name in enumerate(data.names):
            cameras = data.scene.cameras
            in_camera = points @ cameras.viewmats[i, :3, :3].T + cameras.viewmats[i, :3, 3]
            pixels = in_camera @ cameras.Ks[i].T
            pixels = np.floor(pixels[:, :2] / pixels[:, 2:]).astype(int)
            for k, (x, y) in enumerate(pixels):
                if 0 <= x < 64 and 0 <= y < 48:
                    expected[k] += capture.photos[name][y, x]
                    number[k] += 1
        np.testing.assert_allclose(data.scene.points.colors, expected / number[:, None], atol=0.51)

    def test_masked_pixels_give_no_color(self, make_capture: Callable) -> None:
        """Oracle: grey points where all photos are masked out."""
        capture = make_capture(black=True)
        for name in capture.photos:
            write_png(capture.root / "masks" / name, np.zeros((48, 64), np.uint8))
        assert (_load(capture.root).scene.points.colors == 128).all()

    def test_one_coloured_point_is_enough(self, make_capture: Callable) -> None:
        """Oracle: a model with a single coloured point; only entirely black ones lack colours."""
        capture = make_capture()
        rgb = np.zeros_like(capture.model.points.rgb)
        rgb[2] = 9
        points = replace(capture.model.points, rgb=rgb)
        write_model(replace(capture.model, points=points), capture.root / "sparse" / "0")
        data = _load(capture.root)
        assert data.warnings == ()
        np.testing.assert_array_equal(data.scene.points.colors, rgb)

    def test_no_points(self, make_capture: Callable) -> None:
        """Oracle: random ones, the same every time, most of them in view, and a warning."""
        capture = make_capture()
        write_model(
            replace(capture.model, points=ColmapPoints.none()), capture.root / "sparse" / "0"
        )
        first, second = _load(capture.root), _load(capture.root)
        assert len(first.scene.points) == 100_000
        np.testing.assert_array_equal(first.scene.points.points, second.scene.points.points)
        assert any("no points. Unless points can be computed" in w for w in first.warnings)

    @pytest.mark.parametrize(("black", "far"), [(False, np.nan), (True, np.nan), (False, -1e300)])
    def test_points_that_are_not_finite(
        self, black: bool, far: float, make_capture: Callable
    ) -> None:
        """Oracle: the other points, with their colours."""
        capture = make_capture()
        xyz = capture.model.points.xyz.copy()
        xyz[[1, 3], 0] = [far, np.inf]
        rgb = capture.model.points.rgb * np.uint8(not black)
        points = replace(capture.model.points, xyz=xyz, rgb=rgb)
        write_model(replace(capture.model, points=points), capture.root / "sparse" / "0")
        data = _load(capture.root)
        assert "2 points are not finite or beyond 1e+30, the first of" in data.warnings[0]
        assert f"number 1 at [{far}, " in data.warnings[0]
        np.testing.assert_array_equal(data.scene.points.points, xyz[[0, 2, 4, 5]])
        shown = capture.model.points.rgb[[0, 2, 4, 5]]
        if not black:
            np.testing.assert_array_equal(data.scene.points.colors, shown)
        else:
            assert len(data.warnings) == 2
            nearest = np.abs(data.scene.points.colors.astype(int)[:, None] - shown[None]).sum(-1)
            assert (nearest.argmin(axis=1) == np.arange(4)).all()


def test_hostile_folder(make_capture: Callable, mutations: Callable) -> None:
    """Oracle: a capture or one of our errors, for a damaged model or photo."""
    capture = make_capture(views=4)
    for path in (capture.root / "sparse/0/images.bin", capture.root / "images/view_01.png"):
        good = path.read_bytes()
        for k, raw in enumerate(mutations(good)):
            if k % 3:
                continue
            path.write_bytes(raw)
            try:
                _load(capture.root).preload(threads=1)
            except GsError as error:
                assert str(error)
        path.write_bytes(good)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "views", "test"), [("plush", 59, 8), ("stone_horse", 60, 8), ("lund", 29, 4)]
)
def test_real_captures(name: str, views: int, test: int, data_root: Path) -> None:
    """Oracle: the numbers in the captures' notes, and their reprojection error from the points."""
    data = _load(data_root / name, eval=True, resolution=2)
    assert (len(data), len(data.test), data.warnings) == (views, test, ())
    data.preload()
    assert sum(data.image(i).nbytes for i in range(views)) == data.nbytes
    model = read_model(data_root / name)
    by_name = {image.name: image for image in model.images}
    index = {point_id: k for k, point_id in enumerate(model.points.ids.tolist())}
    cameras, errors = data.scene.cameras, []
    for i, view in enumerate(data.names):
        image = by_name[view]
        seen = image.point3D_ids != -1
        points = data.scene.points.points[[index[k] for k in image.point3D_ids[seen].tolist()]]
        in_camera = points @ cameras.viewmats[i, :3, :3].T + cameras.viewmats[i, :3, 3]
        pixels = in_camera @ cameras.Ks[i].T
        camera = model.cameras[image.camera_id]
        ratio = [cameras.widths[i] / camera.width, cameras.heights[i] / camera.height]
        errors.append(pixels[:, :2] / pixels[:, 2:] - image.xys[seen] * ratio)
    assert np.linalg.norm(np.concatenate(errors), axis=1).mean() < 0.7 / 2 + 0.05

"""360-degree photos, detected by XMP and by content, and ordinary ones of the same proportions."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gscore
from gscore.commands import main
from gscore.sfm.panorama import (
    HINTED,
    ORDINARY,
    PARTIAL,
    PLAIN,
    POSSIBLE,
    SEEN,
    STATED,
    panorama_of,
    possible_panoramas,
    refused_panoramas,
)
from gscore.sfm.search_request import SearchRequest

from .conftest import STUDIO

Out = pytest.CaptureFixture[str]
XMP = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description '
    b'xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" '
    b'GPano:ProjectionType="equirectangular"/></x:xmpmeta>'
)
FACES = {  # rows of rotations, world to camera: right, down and ahead of each face of a cube
    "front": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "right": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
    "back": [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
    "left": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    "down": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "up": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
}


def sphere() -> gscore.Splats:
    """Splats in all directions, with a bright sky and a dark ground; y is down."""
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(3000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    light = np.clip(0.5 - 0.5 * ways[:, 1:2], 0, 1)  # sky above, ground below
    colours = 1.2 * (2 * light - 1) + rng.uniform(-0.5, 0.5, (3000, 3))
    return gscore.Splats(
        means=(5 * ways).astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (3000, 1)),
        scales=np.log(rng.uniform(0.2, 0.4, (3000, 3))).astype(np.float32),
        opacities=np.full(3000, 4.0, np.float32),
        sh0=colours[:, None].astype(np.float32),
        shN=np.zeros((3000, 0, 3), np.float32),
    )


def panorama(place: np.ndarray, splats: gscore.Splats, width: int = 512) -> Image.Image:
    """An equirectangular picture of splats from a place [3]; y is down."""
    side = width // 2
    K = np.array([[side / 2, 0, side / 2], [0, side / 2, side / 2], [0, 0, 1.0]])
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(side) + 0.5) / side)
    longitude, latitude = 2 * np.pi * (u - 0.5), np.pi * (v - 0.5)
    rays = np.stack(
        [np.cos(latitude) * np.sin(longitude), np.sin(latitude),
         np.cos(latitude) * np.cos(longitude)], axis=-1,
    )  # fmt: skip
    best, out = np.full(u.shape, -1.0), np.zeros((side, width, 3))
    for rows in FACES.values():
        viewmat = np.eye(4)
        viewmat[:3, :3] = rows
        viewmat[:3, 3] = -viewmat[:3, :3] @ place
        face = gscore.render(splats, K, viewmat, side, side).rgb
        local = rays @ viewmat[:3, :3].T
        mine = local[..., 2] > best
        best[mine] = local[..., 2][mine]
        at = local[mine][:, :2] / local[mine][:, 2:] * side / 2 + side / 2
        columns, rows_at = np.clip(at.astype(int), 0, side - 1).T
        out[mine] = face[rows_at, columns]
    return Image.fromarray((np.clip(out, 0, 1) * 255).round().astype(np.uint8))


@pytest.fixture(scope="module")
def panoramas() -> list[Image.Image]:
    """Four of one scene."""
    return [panorama(np.array([0.3 * i, 0.0, 0.1 * i]), sphere()) for i in range(4)]


def plain_seam(picture: Image.Image) -> Image.Image:
    """The panorama with a wall of one colour at its back, between a plain ceiling and floor."""
    pixels = np.array(picture)
    width = pixels.shape[1]
    pixels[:, : width // 8] = pixels[:, -width // 8 :] = 140
    pixels[:2] = pixels[-2:] = 150
    return Image.fromarray(pixels)


def test_panoramas_are_detected_by_content(panoramas: list[Image.Image]) -> None:
    """Oracle: pictures of all directions, each also turned about the vertical, and with a tripod at
    the lower edge; half of one and one that is not twice as wide as high are not detected."""
    for picture in panoramas:
        for shift in (0, 100, 333):
            rolled = np.roll(np.asarray(picture), shift, axis=1)
            assert panorama_of(Image.fromarray(rolled)) == SEEN
            rolled[-8:, 100:180], rolled[-8:, 300:380] = 0, 255
            assert panorama_of(Image.fromarray(rolled)) == SEEN
        assert panorama_of(plain_seam(picture)) == PLAIN
    width, height = panoramas[0].size
    assert not panorama_of(panoramas[0].crop((0, height // 4, width // 2, height // 2)))
    assert not panorama_of(panoramas[0].crop((0, 0, width, height - 10)))


def test_ordinary_photos_twice_as_wide_as_high_are_none(tmp_path: Path) -> None:
    """Oracle: strips of photos and one colour; an object on white is undecidable, but with a lens
    in EXIF, and one before a wall."""
    plain = SearchRequest(photos=tmp_path, output=tmp_path / "o")
    for place in (0, 0.5, 1):
        kinds = {}
        for i in range(0, 60, 6):
            with Image.open(STUDIO / f"images/view_{i:03}.jpg") as photo:
                top = int(place * (photo.height - photo.width // 2))
                strip = photo.crop((0, top, photo.width, top + photo.width // 2))
                assert strip.width == 2 * strip.height
                kinds[str(i)] = panorama_of(strip)
        assert not refused_panoramas(kinds, plain)
    white = np.full((200, 400, 3), 255, np.uint8)
    assert panorama_of(Image.fromarray(white)) == ORDINARY
    white[60:150, 120:280] = np.random.default_rng(0).integers(0, 255, (90, 160, 3))
    alone = Image.fromarray(white)
    assert panorama_of(alone) == PLAIN
    assert panorama_of(alone, ("Phone", "9", "", "4.2", "26")) == POSSIBLE
    white[150:, 120:280] = white[60:110, 120:280]
    assert panorama_of(Image.fromarray(white)) == POSSIBLE


@pytest.mark.parametrize("ending", ["jpg", "png", "webp"])
def test_xmp_states_a_panorama(ending: str, tmp_path: Path) -> None:
    """Oracle: the packet of Photo Sphere XMP, written by Pillow and, in PNG, as its text chunk."""
    from PIL.PngImagePlugin import PngInfo

    picture = Image.fromarray(np.zeros((20, 30, 3), np.uint8))
    picture.save(tmp_path / f"plain.{ending}")
    if ending == "png":
        text = PngInfo()
        text.add_itxt("XML:com.adobe.xmp", XMP.decode())
        picture.save(tmp_path / "stated.png", pnginfo=text)
    else:
        picture.save(tmp_path / f"stated.{ending}", xmp=XMP)
    for name, wanted in (("plain", ""), ("stated", HINTED)):
        with Image.open(tmp_path / f"{name}.{ending}") as image:
            assert panorama_of(image) == wanted


def _with_xmp(size: tuple[int, int], fields: str) -> Image.Image:
    image = Image.new("RGB", size, "gray")
    image.info["xmp"] = f"<rdf:Description {fields}/>".encode()
    return image


CROPPED = "GPano:CroppedAreaImageWidthPixels='{}' GPano:CroppedAreaImageHeightPixels='{}'"


@pytest.mark.parametrize(
    ("size", "fields", "kind"),
    [
        ((60, 30), 'GPano:ProjectionType="equirectangular"', STATED),
        ((60, 30), "GPano:ProjectionType = 'Equirectangular'", STATED),
        ((60, 30), "><GPano:ProjectionType>equirectangular</GPano:ProjectionType>", STATED),
        ((60, 20), 'GPano:ProjectionType="equirectangular"', HINTED),
        ((60, 20), f'GPano:ProjectionType="equirectangular" {CROPPED.format(60, 20)}', PARTIAL),
        ((60, 20), f'GPano:ProjectionType="equirectangular" {CROPPED.format(600, 300)}', HINTED),
        ((60, 10), 'GPano:ProjectionType="cylindrical"', PARTIAL),
        ((60, 30), 'GPano:ProjectionType="cylindrical"', PARTIAL),
        ((60, 30), 'GPano:ProjectionType="rectilinear"', ORDINARY),
        ((60, 30), 'GPano:UsePanoramaViewer="True"', ORDINARY),
    ],
)
def test_projections_of_xmp(size: tuple[int, int], fields: str, kind: str) -> None:
    """Oracle: the projections of Photo Sphere XMP, with valid and invalid sizes."""
    assert panorama_of(_with_xmp(size, fields)) == kind


@pytest.mark.parametrize(
    "camera", ["RICOH THETA V", "Insta360 X3", "GoPro MAX", "SAMSUNG Gear 360", "Garmin VIRB 360"]
)
def test_cameras_that_take_panoramas_alone(camera: str) -> None:
    """Oracle: stitched photos of 2:1; their other photos are ordinary."""
    assert panorama_of(Image.new("RGB", (60, 30)), (camera, ""), whole=False) == STATED
    assert not panorama_of(Image.new("RGB", (40, 30)), (camera, ""), whole=False)
    for lens, kind in (("", POSSIBLE), ("3.0", ORDINARY)):
        other = ("GoPro", "HERO9", "", lens, "")
        assert panorama_of(Image.new("RGB", (60, 30)), other, whole=False) == kind


def test_given_lens_overrides_detection(tmp_path: Path) -> None:
    """Oracle: photos detected by content or by inconsistent XMP, but not those stated by XMP."""
    plain = SearchRequest(photos=tmp_path, output=tmp_path / "o")
    for lens in (replace(plain, focal_length=500.0), replace(plain, camera_model="OPENCV")):
        for kind, excused in ((STATED, False), (PARTIAL, False), (HINTED, True), (SEEN, True)):
            assert refused_panoramas({"a": kind}, plain)
            assert bool(refused_panoramas({"a": kind}, lens)) != excused
        assert bool(refused_panoramas({"a": PLAIN}, plain)) and not refused_panoramas(
            {"a": PLAIN}, lens
        )
        assert possible_panoramas({"a": POSSIBLE, "b": ""}, plain)
        assert not possible_panoramas({"a": POSSIBLE}, lens)
    assert "v360" not in refused_panoramas({"a": PARTIAL}, plain)
    assert not possible_panoramas({"a": ORDINARY, "b": ""}, plain)


@pytest.mark.parametrize(
    ("kinds", "refused"),
    [
        ([SEEN, SEEN, PLAIN] + 20 * [""], 3),
        ([SEEN, ORDINARY, ORDINARY] + 20 * [""], 0),
        ([PLAIN, PLAIN, ORDINARY], 2),
        ([PLAIN, PLAIN] + 20 * [""], 0),
        ([SEEN, HINTED, ORDINARY, ORDINARY], 1),
    ],
)
def test_share_of_photos_that_makes_a_panorama_capture(
    kinds: list[str], refused: int, tmp_path: Path
) -> None:
    """Oracle: most of those twice as wide as high, and plain ones alone most of all photos; others
    are named in a warning."""
    request = SearchRequest(photos=tmp_path, output=tmp_path / "o")
    photos = {str(i): kind for i, kind in enumerate(kinds)}
    text = refused_panoramas(photos, request)
    assert text.startswith(f"{refused} photo") if refused else not text
    assert refused or possible_panoramas(photos, request)


@pytest.mark.parametrize("kind", [STATED, SEEN, PLAIN])
def test_a_search_refuses_panoramas_and_says_how_to_cut_them(
    kind: str, panoramas: list[Image.Image], tmp_path: Path, capsys: Out
) -> None:
    """Oracle: one sentence and no capture; with a focal length, photos without XMP are ordinary,
    and no model is found for another reason."""
    (tmp_path / "walk").mkdir()
    stated = kind == STATED
    for i, picture in enumerate(panoramas):
        shown = plain_seam(picture) if kind == PLAIN else picture
        shown.save(tmp_path / f"walk/{i}.jpg", xmp=XMP if stated else b"")
    asked = ["sfm", str(tmp_path / "walk"), "-o", str(tmp_path / "found"), "--quiet"]
    assert main(asked) == 2
    reported = " ".join(capsys.readouterr().err.split())
    show = "show" if stated else "seem to show"
    assert f"4 photos {show} all directions" in reported and "v360=equirect:flat" in reported
    assert "Traceback" not in reported and not (tmp_path / "found").exists()
    main([*asked, "--focal-length", "500"])
    assert ("all directions" in " ".join(capsys.readouterr().err.split())) == stated


def test_the_lens_model_of_panoramas_is_refused(photos: Path, tmp_path: Path, capsys: Out) -> None:
    """Oracle: one sentence on how to cut them; pycolmap divides by zero."""
    asked = ["sfm", str(photos), "-o", str(tmp_path / "found"), "--quiet"]
    assert main([*asked, "--camera-model", "EQUIRECTANGULAR"]) != 0
    reported = " ".join(capsys.readouterr().err.split())
    assert "camera_model EQUIRECTANGULAR is for 360-degree photos" in reported
    assert "v360=equirect:flat" in reported and "Traceback" not in reported

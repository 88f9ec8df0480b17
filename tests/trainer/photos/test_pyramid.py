"""Views at smaller sizes; oracle: means of blocks and the projection of points."""

from collections.abc import Callable
from typing import Any

import numpy as np

from gscore.trainer.photos.image_pyramid import ImagePyramid


def test_photos_are_averaged_and_cameras_keep_pointing(make_photos: Callable[..., Any]) -> None:
    """Oracle: 2 x 2 means; a point projected by the full camera, halved."""
    photos = make_photos()
    cameras = photos.scene.cameras
    pyramid = ImagePyramid(photos, cameras, near=0.01)
    for index in (0, 3):
        view, image, mask, *_ = pyramid.at(index, 2.0)
        full = photos.image(index).astype(np.float64)
        means = full.reshape(24, 2, 24, 2, 3).mean(axis=(1, 3))
        assert image.shape == (24, 24, 3)
        assert mask is None
        assert np.abs(image - means).max() <= 0.5
        point = np.array([0.2, -0.3, 0.1, 1.0])
        here = cameras.Ks[index] @ (cameras.viewmats[index] @ point)[:3]
        there = view.K.astype(np.float64) @ (view.viewmat @ point)[:3]
        np.testing.assert_allclose(there[:2] / there[2], here[:2] / here[2] / 2, atol=1e-5)
    assert pyramid.at(3, 2.0).image is image, "scaled once"
    assert pyramid.at(3, 1.0).image is photos.image(3)
    assert pyramid.at(3, 48.0 * 4).image.shape == (1, 1, 3)


def test_odd_sizes_scale_each_axis_by_its_own_ratio(make_photos: Callable[..., Any]) -> None:
    """Oracle: 48 / sqrt(2) rounds to 34, so K is scaled by 34 / 48."""
    photos = make_photos()
    view = ImagePyramid(photos, photos.scene.cameras, near=0.01).at(0, 2**0.5).view
    assert (view.width, view.height) == (34, 34)
    np.testing.assert_allclose(view.K[:2], photos.scene.cameras.Ks[0][:2] * 34 / 48)


def test_masked_pixels_do_not_bleed_in(make_photos: Callable[..., Any]) -> None:
    """Oracle: a red left half next to a hidden green right half, and the mean of the mask."""
    photos = make_photos()
    photos.images[0] = np.zeros((48, 48, 3), np.uint8)
    photos.images[0][:, :25, 0] = 200
    photos.images[0][:, 25:, 1] = 200
    photos.masks[0] = np.zeros((48, 48), np.uint8)
    photos.masks[0][:, :25] = 255
    _, image, mask, *_ = ImagePyramid(photos, photos.scene.cameras, near=0.01).at(0, 2.0)
    assert mask is not None
    assert np.abs(image[:, 12].astype(int) - (200, 0, 0)).max() <= 1
    assert (mask[:, 12] == 128).all() or (mask[:, 12] == 127).all()
    assert (mask[:, :12] == 255).all()
    assert (mask[:, 13:] == 0).all()


def test_tiles_that_a_mask_hides_are_left_out_where_it_says_ignore(
    make_photos: Callable[..., Any],
) -> None:
    """Oracle: by hand: 20 of 48 columns are kept, and the first ten of 24."""
    photos = make_photos()
    photos.masks[0] = np.zeros((48, 48), np.uint8)
    photos.masks[0][:, :20] = 255
    for mode, full, half, share in (
        ("ignore", [[1, 1, 0]] * 3, [[1, 0]] * 2, 20 / 48),
        ("composite", None, None, 1.0),
    ):
        photos.mask_mode = mode
        pyramid = ImagePyramid(photos, photos.scene.cameras, near=0.01)
        for factor, tiles in ((1.0, full), (2.0, half)):
            found = pyramid.at(0, factor)
            assert (None if found.tiles is None else found.tiles.tolist()) == tiles
            assert abs(found.counted - share) < 1e-6
            assert pyramid.at(1, factor)[3:] == (None, 1.0, 0)

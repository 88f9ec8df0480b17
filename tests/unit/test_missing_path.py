"""Messages on paths that do not exist; oracle: the names in the folder."""

from pathlib import Path

import pytest

from gscore.io.missing_path import missing_path


@pytest.mark.parametrize(
    ("path", "kind", "message"),
    [
        ("wlak.mp4", "folder", "There is no video {0}/wlak.mp4; did you mean {0}/walk.mp4?"),
        ("a.mov", "video", "There is no video {0}/a.mov; its folder has walk.mp4, über uns.MOV."),
        ("photo", "folder", "There is no folder {0}/photo; did you mean {0}/photos?"),
        ("walk", "folder", "There is no folder {0}/walk. Advice."),
        ("walk", "file or folder", "There is no file or folder {0}/walk; did you mean"),
        ("none/walk.mp4", "folder", "There is no video {0}/none/walk.mp4. Advice."),
    ],
)
def test_the_nearest_name_of_the_kind(tmp_path: Path, path: str, kind: str, message: str) -> None:
    """Oracle: names of the kind that differ by a letter or two; else the videos."""
    for name in ("walk.mp4", "über uns.MOV", ".hidden.mp4", "photos.txt"):
        (tmp_path / name).touch()
    (tmp_path / "photos").mkdir()
    assert missing_path(tmp_path / path, kind, "Advice.").startswith(message.format(tmp_path))

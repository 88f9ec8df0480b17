"""Link or copy: a file under a second name, hard-linked where possible, else copied."""

import os
import shutil
from pathlib import Path


def link_or_copy(source: Path, target: Path) -> None:
    """Give the file `source` the name `target`, whose folder is made.

    A hard link takes no space and holds the file even where its first name is removed. File
    systems without them, and targets on another one, get a copy.

    Raises:
        OSError: it cannot be written.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source.resolve(), target)
    except OSError:
        shutil.copy2(source, target)

"""Link or copy: a file under a second name, hard-linked where possible, else copied."""

import os
import shutil
from pathlib import Path


def link_or_copy(source: Path, target: Path) -> None:
    """Hard-link the file `source` to `target`, or copy it; the folder of `target` is made.

    A hard link takes no space and stays valid if the first name is removed. Targets on another file
    system, or on one without hard links, get a copy.

    Raises:
        OSError: `target` cannot be written.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source.resolve(), target)
    except OSError:
        shutil.copy2(source, target)

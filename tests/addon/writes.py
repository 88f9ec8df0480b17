"""Record of the add-on's writes by an audit hook, which no code in the process can avoid.

It does not record writes by Blender itself (saved files, rendered pictures) or by processes that
the add-on starts.
"""

import os
import sys
from pathlib import Path

ADDON = str(Path(__file__).parents[2] / "addon") + os.sep
_CHANGED = {
    "os.mkdir": {0: 2},
    "os.remove": {0: 1},
    "os.rename": {0: 2, 1: 3},
    "os.rmdir": {0: 1},
    "os.link": {1: 3},
    "os.symlink": {1: 2},
    "os.truncate": {0: None},
    "shutil.copyfile": {1: None},
    "shutil.rmtree": {0: 1},
}
"""Events of Python's audit table by which files change: which of their arguments are paths, and
which the open folder that such a path is relative to."""
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


class Writes:
    """Paths that the add-on's code, or code it calls, has written, made or removed."""

    def __init__(self) -> None:
        self.paths: set[Path] = set()
        sys.addaudithook(self._audit)

    def outside(self, *allowed: Path) -> list[Path]:
        """Paths outside of all given folders."""
        roots = [folder.resolve() for folder in allowed]
        return sorted(p for p in self.paths if not any(p.is_relative_to(r) for r in roots))

    def _audit(self, event: str, arguments: tuple) -> None:
        if event == "open":
            places = {0: None} if arguments[2] & _WRITING else {}
        else:
            places = _CHANGED.get(event, {})
        if not places or not _called_by_addon():
            return
        for place, folder in places.items():
            given = arguments[place]
            within = folder is not None and arguments[folder] not in (-1, None)
            # An open file, or a path in a tree whose removal was recorded at its root.
            if isinstance(given, int) or within:
                continue
            path = Path(os.fsdecode(given)).absolute()
            # Bytecode is written by Python; Blender keeps it next to the modules.
            if "__pycache__" not in path.parts and path != Path(os.devnull):
                self.paths.add(path.resolve())


def _called_by_addon() -> bool:
    frame = sys._getframe(2)
    while frame is not None:
        if frame.f_code.co_filename.startswith(ADDON):
            return True
        frame = frame.f_back
    return False

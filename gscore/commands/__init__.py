"""Command line: `gscore COMMAND ...`.

A verb is a module here with `add_arguments(parser)` and `run(args) -> int` (the exit code). Only
the module of the given verb is imported, so that a missing optional package of one verb does not
break the others.

Exit codes: 0 done; 1 an error inside gscore; 2 bad input, or a full disk; 3 stopped by a line or
the end of stdin before there were results to keep; 128 + N ended by signal N (SIGHUP 129, SIGINT
130, SIGTERM 143), 141 because the reader of the output closed it.
"""

import argparse
import errno
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from .._version import __version__
from ..config import MOST_THREADS
from ..errors import BackendError, ConfigError, GsError
from ..events import Failed
from ..extras import install_hint, missing, package_facts
from ..io.files import reason
from ..quoting import brief, nearest, quoted
from ..text_format import count_text
from .parser import Parser, UsageExit, sentence
from .terminal.display import JsonLines
from .terminal.interrupt import Interrupt, interrupts, is_worker, safe_streams
from .terminal.status import print_warnings, show_while, wrapped

VERBS = {
    "frames": "choose sharp frames of a video for a folder of photos",
    "sfm": "find the cameras of photos and write them as a capture",
    "train": "train splats from photos, with or without cameras, or from a video",
    "sequence": "train the frames of a multi-view video in order",
    "options": "list the options of a training",
    "eval": "measure trained splats against the photos",
    "compare": "compare two runs on one capture, view by view",
    "depth": "predict depth maps and align them with the capture",
    "lod": "build levels of detail for splats larger than the memory",
    "render": "render splats to pictures or a video",
    "view": "write a page that shows splats in a browser",
    "convert": "convert splats to another format; crop, clean, prune or move them",
    "mesh": "make a triangle mesh of the surface of splats",
    "refit": "fit splats to the viewer that will show them",
    "split": "cut a large capture into blocks, each a capture of its own",
    "merge": "merge splats trained block by block",
    "info": "summarise a capture, photos, a video, a PLY or a run",
    "doctor": "check this machine and its packages",
    "bench": "measure speed",
    "stress": "measure numerical errors",
}

_EXAMPLES = {
    "frames": "Example: gscore frames walk.mp4 -o photos",
    "sfm": "Example: gscore sfm photos/ -o capture",
    "train": "Example: gscore train photos/ -o run --preset draft --eval",
    "sequence": "Example: gscore sequence CASE --frames 0:145:5 -o out",
    "options": "Example: gscore options opacity",
    "eval": "Example: gscore eval run",
    "compare": "Example: gscore compare run1 run2 -o compare.html",
    "depth": "Example: gscore depth photos/ --model midas.onnx",
    "lod": "Example: gscore lod city.ply -o city.lod",
    "render": "Example: gscore render run -o orbit.mp4",
    "view": "Example: gscore view run -o page.html",
    "convert": "Example: gscore convert run small.ply --clean --count 100000",
    "mesh": "Example: gscore mesh run -o mesh.glb --triangles 200000",
    "refit": "Example: gscore refit run --for-viewer blender",
    "split": "Example: gscore split city -o blocks --blocks 8",
    "merge": "Example: gscore merge runs -o city.ply",
    "info": "Example: gscore info photos/",
}
"""Last line of a verb's help."""
_DISK_ERRORS = {
    *(errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM),
    *(errno.ENAMETOOLONG, errno.ELOOP),
}
"""Refusals of the system that a user can mend; others are errors inside gscore."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit code and never raises for errors that a user can cause."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    with interrupts() as interrupt, safe_streams(interrupt.output_lost):
        code = _main(arguments, interrupt)
    return code or interrupt.exit_code


def _main(arguments: list[str], interrupt: Interrupt) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_usage())
        return 0 if arguments else 2
    verb, *rest = arguments
    if verb in ("-V", "--version"):
        print(f"gscore {__version__}")
        return 0
    if verb == "help":
        return _main([*rest[:1], "--help"], interrupt)
    if verb not in VERBS:
        guess = nearest(verb, [*VERBS, "help"])
        hint = f"did you mean `gscore {guess}`?" if guess else f"commands: {', '.join(VERBS)}."
        return _complain("gscore", f"there is no command {quoted(verb)}; {hint}")
    if not _is_here(verb):
        hint = "the Blender extension leaves it out; pip install gscore adds it."
        return _complain("gscore", f"`gscore {verb}` is not part of this installation; {hint}")
    return _guarded(f"gscore {verb}", verb, rest, interrupt)


def dashed(arguments: Sequence[str]) -> list[str]:
    """The arguments with `--some_name` spelled `--some-name`, as 3DGS users may write either."""
    result = []
    for argument in arguments:
        name, sep, value = argument.partition("=")
        result.append((name.replace("_", "-") if name.startswith("--") else name) + sep + value)
    return result


def _guarded(prog: str, verb: str, arguments: list[str], interrupt: Interrupt) -> int:
    has_events = any(word.partition("=")[0] == "--events" for word in arguments)
    sends_events = has_events and not is_worker()
    try:
        _check_working_folder()
        wants_help = any(word in ("-h", "--help", "--quiet", "--events") for word in arguments)
        with show_while(sys.stderr, "" if wants_help else f"Starting {prog}"):
            module = import_module(f".{verb}", __package__)
        parser = Parser(
            prog=prog,
            description=sentence(VERBS[verb]),
            epilog=_EXAMPLES.get(verb),
            allow_abbrev=False,
        )
        module.add_arguments(parser)
        args = parser.parse_args(dashed(arguments))
        with interrupt.working():
            print_warnings(_more_threads_than_cores(args))
            return module.run(args)
    except SystemExit as stop:  # the parser has already printed the error
        if sends_events and isinstance(stop, UsageExit):
            _send(Failed(message=stop.sentence, type=ConfigError.__name__))
        return stop.code if isinstance(stop.code, int) else 2
    except BaseException as error:
        # Libraries turn a KeyboardInterrupt into errors of their own.
        if interrupt.raised or isinstance(error, KeyboardInterrupt):
            print("Stopped.", file=sys.stderr)
            return interrupt.exit_code or 130
        if sends_events:
            _send(_failed(prog, error))
        message = _message(prog, error)
        return _complain(prog, message) if message else _internal(prog, error)


def _more_threads_than_cores(args: argparse.Namespace) -> list[str]:
    threads = getattr(args, "threads", None)
    if not isinstance(threads, int) or not 1 < threads <= MOST_THREADS:
        return []
    from ..metrics.machine import cores  # not in every start of the program

    if threads <= (most := cores()):
        return []
    have = f"this machine has {count_text(most, 'core')}"
    return [f"`--threads {threads}`: {have}, so more threads are slower. Leave it out."]


def _check_working_folder() -> None:
    """Check that the working folder exists, because libraries loaded later exit without it.

    Raises:
        ConfigError: the folder was removed, or access is denied.
    """
    try:
        Path.cwd()
    except OSError as error:
        raise ConfigError(
            "The working folder was removed, or access to it is denied; change into another one "
            "with cd."
        ) from error


def _message(prog: str, error: BaseException) -> str:
    """The message of an error that a user can mend; empty for others."""
    match error:
        case GsError():
            return str(error)
        case ModuleNotFoundError() if install_hint(error.name or ""):
            return missing(error.name or "", f"`{prog}`")
        case MemoryError():
            return "out of memory; try fewer splats or smaller pictures."
        case OSError() if error.errno in _DISK_ERRORS:
            return f"{brief(error.filename or 'output')}: {reason(error)}"
    return ""


def _failed(prog: str, error: BaseException) -> Failed:
    """The event of an error."""
    facts = {}
    if isinstance(error, BackendError):
        facts = {"package": error.package, "install": error.install}
    elif isinstance(error, ModuleNotFoundError) and install_hint(error.name or ""):
        facts = package_facts(error.name or "")
    name = type(error).__name__
    message = _message(prog, error) or str(error) or name
    return Failed(message=message, type=name, **facts)


def _send(event: Failed) -> None:
    """Write an event to stdout, unless its reader closed it."""
    JsonLines(sys.stdout, on_closed=lambda: None)(event)


def _is_here(verb: str) -> bool:
    """Whether a verb is installed; the Blender extension leaves some out."""
    return find_spec(f".{verb}", __package__) is not None


def _usage() -> str:
    purpose = "3D Gaussian Splatting on CPUs and graphics cards."
    lines = ["usage: gscore COMMAND ...", "", purpose, ""]
    lines += [f"  {verb:8} {text}" for verb, text in VERBS.items() if _is_here(verb)]
    return "\n".join([*lines, "", "`gscore help COMMAND` lists the options of a command."])


def _complain(prog: str, message: str) -> int:
    print(wrapped(f"{prog}: error: {message}", sys.stderr), file=sys.stderr)
    return 2


def _internal(prog: str, error: BaseException) -> int:
    traceback.print_exception(error)
    print(
        f"{prog}: this is an error in gscore; please report it with the lines above.",
        file=sys.stderr,
    )
    return 1

"""Command line: `gscore VERB ...`.

A verb is a module here with `add_arguments(parser)` and `run(args) -> int` (the exit code). Only
the module of the verb that was asked for is imported, so that a missing optional package of one
verb does not break the others. Exit codes: 0 done, 1 an error inside gscore, 2 bad input, 130 and
143 for SIGINT and SIGTERM.
"""

import errno
import os
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module

from .._version import __version__
from ..errors import GsError
from ..extras import how_to_install, missing
from ..shown import quoted, shown
from .parser import Parser, nearest, sentence
from .status import beginning, wrapped

VERBS = {
    "train": "train splats from photos with COLMAP cameras",
    "sequence": "train the frames of a multi-view video one after another",
    "eval": "measure trained splats against the photos",
    "depth": "predict depth maps and align them with the capture",
    "render": "render splats to pictures or a video",
    "info": "say what a capture, a PLY or a run holds",
    "doctor": "say what this machine can do and what is missing",
    "bench": "measure speed",
    "stress": "measure numerical errors",
}

_EXAMPLES = {
    "train": "Example: gscore train photos/ -o run --preset draft --eval",
    "sequence": "Example: gscore sequence CASE --frames 0:145:5 -o out",
    "eval": "Example: gscore eval run",
    "depth": "Example: gscore depth photos/ --model midas.onnx",
    "render": "Example: gscore render run -o orbit.mp4",
    "info": "Example: gscore info photos/",
}
"""At the end of a verb's help."""
_DISK_ERRORS = {
    errno.ENOSPC: "the disk is full; free some space or choose another output",
    errno.EDQUOT: "your disk quota is used up; free some space or choose another output",
    errno.EROFS: "the file system is read-only; choose another output",
    errno.EACCES: "permission denied; check the rights or choose another path",
    errno.EPERM: "the operation is not permitted; check the rights or choose another path",
    errno.ENAMETOOLONG: "the name is too long for the file system; choose a shorter one",
    errno.ELOOP: "its links lead in a circle; choose another path",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit code and never raises for what a user can cause."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_usage())
        return 0 if arguments else 2
    verb, *rest = arguments
    if verb in ("-V", "--version"):
        print(f"gscore {__version__}")
        return 0
    if verb == "help":
        return main([*rest[:1], "--help"])
    if verb not in VERBS:
        guess = nearest(verb, [*VERBS, "help"])
        hint = f"did you mean `gscore {guess}`?" if guess else f"verbs: {', '.join(VERBS)}."
        return _complain("gscore", f"there is no verb {quoted(verb)}; {hint}")
    return _guarded(f"gscore {verb}", verb, rest)


def dashed(arguments: Sequence[str]) -> list[str]:
    """The arguments with `--some_name` spelled `--some-name`, as 3DGS users may write either."""
    result = []
    for argument in arguments:
        name, sep, value = argument.partition("=")
        result.append((name.replace("_", "-") if name.startswith("--") else name) + sep + value)
    return result


def _guarded(prog: str, verb: str, arguments: list[str]) -> int:
    try:
        wants_help = any(word in ("-h", "--help", "--quiet", "--events") for word in arguments)
        with beginning(sys.stderr, "" if wants_help else f"Starting {prog}"):
            module = import_module(f".{verb}", __package__)
        parser = Parser(
            prog=prog,
            description=sentence(VERBS[verb]),
            epilog=_EXAMPLES.get(verb),
            allow_abbrev=False,
        )
        module.add_arguments(parser)
        return module.run(parser.parse_args(dashed(arguments)))
    except SystemExit as stop:  # argparse has already said what is wrong
        return stop.code if isinstance(stop.code, int) else 2
    except GsError as error:
        return _complain(prog, str(error))
    except ModuleNotFoundError as error:
        module = error.name or ""
        if not how_to_install(module):
            return _internal(prog)
        return _complain(prog, missing(module, f"`{prog}`"))
    except KeyboardInterrupt:
        print("Stopped.", file=sys.stderr)
        return 130
    except MemoryError:
        return _complain(prog, "out of memory; try fewer splats or smaller pictures.")
    except BrokenPipeError:  # the reader of our output is gone, e.g. `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        reason = _DISK_ERRORS.get(error.errno or 0)
        if reason is None:
            return _internal(prog)
        return _complain(prog, f"{shown(error.filename or 'output')}: {reason}.")
    except Exception:
        return _internal(prog)


def _usage() -> str:
    lines = ["usage: gscore VERB ...", "", "3D Gaussian Splatting on any CPU.", ""]
    lines += [f"  {verb:8} {text}" for verb, text in VERBS.items()]
    return "\n".join([*lines, "", "`gscore help VERB` lists the options of a verb."])


def _complain(prog: str, message: str) -> int:
    print(wrapped(f"{prog}: error: {message}", sys.stderr), file=sys.stderr)
    return 2


def _internal(prog: str) -> int:
    traceback.print_exc()
    print(
        f"{prog}: this is an error in gscore; please report it with the lines above.",
        file=sys.stderr,
    )
    return 1

"""What Python code can do to a machine, found in its syntax tree; names are followed to imports."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


MODULES = _words(
    """__future__ argparse ast atexit base64 codecs collections concurrent contextlib csv ctypes
    dataclasses datetime difflib enum errno fcntl fractions functools hashlib html importlib
    inspect io ipaddress itertools json logging math mmap msvcrt os pathlib platform queue re
    reprlib resource secrets shlex shutil signal sqlite3 stat statistics string struct subprocess
    sys tempfile textwrap threading time traceback types typing unicodedata uuid warnings weakref
    zipfile zlib
    av blf bmesh bpy bpy_extras gpu gpu_extras gscore huggingface_hub lpips mathutils numpy
    onnxruntime OpenEXR PIL plyfile pycolmap safetensors scipy torch"""
)
"""All that is imported. Not among them: pickles, sockets, HTTP, processes that pass pickles."""
FORBIDDEN = _words(
    """eval exec compile __import__ builtins os.system os.popen os.fork os.forkpty os.posix_spawn
    os.posix_spawnp os.startfile subprocess.getoutput subprocess.getstatusoutput
    concurrent.futures.ProcessPoolExecutor concurrent.futures.process logging.config
    logging.handlers torch.load torch.save torch.hub torch.jit torch.distributed
    torch.multiprocessing torch.package torch.utils.cpp_extension torch.utils.model_zoo
    numpy.ctypeslib numpy.DataSource sqlite3.connect sqlite3.Connection"""
)
"""Neither they nor what is below them is named anywhere, called or not."""
_FORBIDDEN_STARTS = ("os.exec", "os.spawn")
_STARTERS = {"run", "Popen", "call", "check_call", "check_output"}
_OF_OS = _words(
    """chmod fdopen link makedirs mkdir mkfifo open remove removedirs rename renames replace rmdir
    symlink truncate unlink utime write"""
)
_OF_SHUTIL = _words(
    "chown copy copy2 copyfile copymode copystat copytree make_archive move rmtree unpack_archive"
)
_METHODS = _words(
    """chmod extract extractall hardlink_to mkdir rename rmdir save save_render savefig savetxt
    savez savez_compressed symlink_to tofile touch unlink write_bytes write_text
    save_as_mainfile save_mainfile save_userpref"""
)
"""Methods that write, of whatever object."""


_GIVERS = {"pillow": "PIL.Image", "need_video": "av"}
"""Functions that give a module, by the name they are called by."""


@dataclass(frozen=True)
class Site:
    """A call."""

    function: str
    """Dotted name of the innermost function or class around it; empty in a module's body."""
    callee: str
    line: int


class Source:
    """One module."""

    def __init__(self, text: str) -> None:
        self._tree = ast.parse(text)
        self._names: dict[str, str] = {}
        self.imported: dict[str, int] = {}
        """Dotted names of all that is imported, with its line; not of the own package."""
        for node in ast.walk(self._tree):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    self.imported[alias.name] = node.lineno
                    root = alias.name.partition(".")[0]
                    self._names[alias.asname or root] = alias.name if alias.asname else root
            elif isinstance(node, ast.Assign) and (module := self._needed(node.value)):
                for target in node.targets:
                    if isinstance(target, ast.Name):
                        self._names[target.id] = module
            elif isinstance(node, ast.ImportFrom):
                base = "." * node.level + (node.module or "")
                for alias in node.names:
                    full = f"{base}.{alias.name}"
                    self._names[alias.asname or alias.name] = full
                    if not node.level:
                        self.imported[full] = node.lineno

    @staticmethod
    def _needed(node: ast.expr) -> str:
        """The module that `need("module", ...)`, `need_video()` or `pillow()` gives; else empty."""
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
            return ""
        first = node.args[0] if node.args else None
        if node.func.id == "need" and isinstance(first, ast.Constant):
            return str(first.value)
        return _GIVERS.get(node.func.id, "")

    def name(self, node: ast.expr | None) -> str:
        """`os.path.join`, with the names that were imported in full; empty for what is none."""
        if isinstance(node, ast.Name):
            return self._names.get(node.id, node.id)
        if isinstance(node, ast.Attribute):
            base = self.name(node.value)
            return f"{base}.{node.attr}" if base else f"?.{node.attr}"
        return ""

    def calls(self) -> Iterator[tuple[Site, ast.Call]]:
        """All calls."""
        yield from self._calls(self._tree, "")

    def _calls(self, node: ast.AST, function: str) -> Iterator[tuple[Site, ast.Call]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Call):
                yield Site(function, self.name(child.func) or "?", child.lineno), child
            inner = function
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                inner = f"{function}.{child.name}" if function else child.name
            yield from self._calls(child, inner)

    def dangers(self) -> Iterator[str]:
        """What no line may do: foreign code, shells, pickles, sockets."""
        for name, line in self.imported.items():
            if name.partition(".")[0] not in MODULES or _is_forbidden(name):
                yield f"line {line}: imports {name}"
        for node in ast.walk(self._tree):
            if not isinstance(node, ast.Name | ast.Attribute) or not isinstance(node.ctx, ast.Load):
                continue
            if _is_forbidden(self.name(node)):
                yield f"line {node.lineno}: names {self.name(node)}"
        for site, call in self.calls():
            for what in self._dangers_of(site, call):
                yield f"line {site.line}: {what}"

    def _dangers_of(self, site: Site, call: ast.Call) -> Iterator[str]:
        given = {word.arg: word.value for word in call.keywords}
        for key in ("shell", "allow_pickle"):
            if key in given and not _is_constant(given[key], False):
                yield f"{site.callee} with {key}"
        if site.callee == "numpy.load" and "allow_pickle" not in given:
            yield "numpy.load without allow_pickle=False"
        if site.callee in {"PIL.Image.open", "PIL.Image.Image.open"} and "formats" not in given:
            yield "PIL.Image.open without formats"
        if site.callee == "av.open" and not _is_local(call):
            yield "av.open of a place that does not begin with file:"
        if site.callee in {"getattr", "operator.attrgetter"} and call.args:
            target = self.name(call.args[0])
            if target in {"os", "subprocess", "torch", "builtins", "shutil"}:
                yield f"getattr of {target}"
        if is_start(site):
            command = call.args[0] if call.args else given.get("args")
            if not isinstance(command, ast.List | ast.Tuple | ast.Name | ast.Attribute):
                yield f"{site.callee}: a command that is no list"

    def starts(self) -> list[Site]:
        """Calls that start a process."""
        return [site for site, _ in self.calls() if is_start(site)]

    def writes(self) -> list[Site]:
        """Calls that write, make, rename or remove files."""
        return [site for site, call in self.calls() if self._writes(site, call)]

    def _writes(self, site: Site, call: ast.Call) -> bool:
        root, _, rest = site.callee.partition(".")
        last = site.callee.rpartition(".")[2]
        if root == "os":
            return rest in _OF_OS
        if root == "shutil":
            return rest in _OF_SHUTIL
        if root == "tempfile" or last in _METHODS or last.startswith(("write_", "atomic_")):
            return True
        if root == "numpy":
            return last.startswith("save")
        if last == "open":
            return _may_write(call, method=site.callee not in {"open", "io.open"})
        # Path.replace takes one argument, str.replace two.
        return last == "replace" and "." in site.callee and len(call.args) == 1 == _size(call)


def _is_local(call: ast.Call) -> bool:
    """Whether the first argument is text that begins with `file:`."""
    first = call.args[0] if call.args else None
    return isinstance(first, ast.JoinedStr) and _is_file(first.values[0])


def _is_file(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and str(node.value).startswith("file:")


def is_start(site: Site) -> bool:
    """Whether it starts a process."""
    root, _, rest = site.callee.partition(".")
    return root == "subprocess" and rest in _STARTERS


def _is_forbidden(name: str) -> bool:
    parts = name.split(".")
    starts = {".".join(parts[: n + 1]) for n in range(len(parts))}
    return bool(starts & FORBIDDEN) or name.startswith(_FORBIDDEN_STARTS)


def _is_constant(node: ast.expr, value: object) -> bool:
    return isinstance(node, ast.Constant) and node.value is value


def _size(call: ast.Call) -> int:
    return len(call.args) + len(call.keywords)


def _may_write(call: ast.Call, *, method: bool) -> bool:
    """Whether the mode of an `open` is other than reading, or not known here."""
    at = 0 if method else 1
    given = [word.value for word in call.keywords if word.arg in {"mode", None}]
    given += call.args[at : at + 1]
    return any(
        not (isinstance(node, ast.Constant) and isinstance(node.value, str))
        or bool(set(node.value) & set("wax+"))
        for node in given
    )

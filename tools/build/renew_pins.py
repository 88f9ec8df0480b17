"""Pin renewal: exact versions and hashes for the environment created by the Blender add-on.

`python tools/build/renew_pins.py` resolves the requirements of pyproject.toml, with torch as in
constraints.txt, for every Python and system of Blender, and writes the files of
addon/trainer_python/pinned/. It installs uv into a temporary environment. Run it with the project's
own Python (.venv), then run the add-on's tests.

torch without CUDA has its own index. Its hashes are written if that index can be reached;
`--without-torch-index` leaves them out: pip then verifies downloads against the index only.
"""

import argparse
import re
import subprocess
import sys
import tempfile
import tomllib
import urllib.error
import urllib.parse
import urllib.request
import venv
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from packaging.markers import Marker
from packaging.tags import compatible_tags, cpython_tags
from packaging.utils import parse_wheel_filename

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "addon" / "trainer_python" / "pinned"
TORCH_INDEX = "https://download.pytorch.org/whl/cpu"
OLDEST, PYTHONS = "3.11", ((3, 11), (3, 12), (3, 13), (3, 14))
SYSTEMS = {
    "linux_x86_64": ("linux", "x86_64", [f"manylinux_2_{n}_x86_64" for n in range(34, 4, -1)]),
    "linux_aarch64": ("linux", "aarch64", [f"manylinux_2_{n}_aarch64" for n in range(34, 16, -1)]),
    "windows_x86_64": ("win32", "AMD64", ["win_amd64"]),
    "macos_aarch64": ("darwin", "arm64", [f"macosx_{n}_0_arm64" for n in range(15, 10, -1)]),
}
"""Systems with torch wheels: Python's platform name, machine, and wheel tags."""
_OLD_LINUX = {"x86_64": ["manylinux2014_x86_64"], "aarch64": ["manylinux2014_aarch64"]}
_WITH_TORCH = re.compile(r"^(torch|triton|nvidia-.*|cuda-.*)$")
_LINK = re.compile(r'href="([^"#]*/(torch-[^"#/]+\.whl))#sha256=([0-9a-f]{64})"')


def requirements() -> list[str]:
    """Requirements of training, with the project's version of torch."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    names = [*project["dependencies"], "pip"]
    for extra in ("train", "lpips", "video", "hub", "mesh"):
        names += extras[extra]
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    return [*names, *(line for line in lines if line and not line.startswith("#"))]


def resolve(names: list[str]) -> list[dict[str, Any]]:
    """The packages of pylock.toml: exact versions with markers, files, sizes and hashes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        venv.create(folder / "uv", with_pip=True)
        scripts = folder / "uv" / ("Scripts" if sys.platform == "win32" else "bin")
        subprocess.run([scripts / "python", "-m", "pip", "install", "-q", "uv"], check=True)
        (folder / "in.txt").write_text("\n".join(names), encoding="utf-8")
        lock = folder / "pylock.toml"
        command = [scripts / "uv", "pip", "compile", "-q", "--universal", "--no-config"]
        command += ["--only-binary", ":all:", "--python-version", OLDEST, "--system-certs"]
        command += ["--format", "pylock.toml", "-o", lock, folder / "in.txt"]
        subprocess.run(command, check=True)
        return tomllib.loads(lock.read_text(encoding="utf-8"))["packages"]


def entry(package: dict[str, Any]) -> str:
    """A package as a pip requirement, with the hashes of all its wheels."""
    marker = f" ; {package['marker']}" if "marker" in package else ""
    hashes = sorted(wheel["hashes"]["sha256"] for wheel in package["wheels"])
    pin = f"{package['name']}=={package['version']}{marker}"
    return " \\\n    ".join([pin, *(f"--hash=sha256:{value}" for value in hashes)])


def megabytes(packages: list[dict[str, Any]]) -> str:
    """Maximum download of each system over all Pythons; systems with missing wheels are omitted."""
    found = {}
    for system, (kind, machine, tags) in SYSTEMS.items():
        tags = [*tags, *(_OLD_LINUX[machine] if kind == "linux" else ())]
        try:
            totals = [sum(_sizes(packages, kind, machine, tags, python)) for python in PYTHONS]
        except LookupError as error:
            print(f"{system}: no environment possible: {error}", file=sys.stderr)
            continue
        found[system] = max(totals)
    return ", ".join(f"{system} {round(size / 1e6) or 1}" for system, size in found.items())


def _sizes(
    packages: list[dict[str, Any]],
    kind: str,
    machine: str,
    tags: list[str],
    python: tuple[int, int],
) -> Iterable[int]:
    """Bytes of each wheel for one Python on one system; LookupError if one is missing."""
    version = ".".join(map(str, python))
    environment = {"sys_platform": kind, "platform_machine": machine, "python_version": version}
    environment |= {"python_full_version": f"{version}.1", "implementation_name": "cpython"}
    fitting = {*cpython_tags(python, platforms=tags), *compatible_tags(python, None, tags)}
    for package in packages:
        if "marker" in package and not Marker(package["marker"]).evaluate(environment):
            continue
        wheels = {wheel["url"].rsplit("/", 1)[1]: wheel["size"] for wheel in package["wheels"]}
        mine = [size for name, size in wheels.items() if parse_wheel_filename(name)[3] & fitting]
        if not mine:
            raise LookupError(
                f"{package['name']} {package['version']} has no wheel for Python {version}"
            )
        yield max(mine)


def write(name: str, about: str, packages: list[dict[str, Any]]) -> None:
    """Write a list of packages from the registry."""
    entries = "\n".join(map(entry, packages))
    text = f"{_head(about)}# megabytes: {megabytes(packages)}\n{entries}\n"
    _replace(FOLDER / name, text)


def write_cpu_torch(version: str, *, hashes: bool) -> None:
    """Write the pin of torch without CUDA, with hashes of its index if requested."""
    pin, about, sizes = f"torch=={version}+cpu", "torch without CUDA, for Linux.", []
    lines = [pin]
    if hashes:
        links = _index_links(version)
        lines += [f"--hash=sha256:{value}" for value in sorted(set(links.values()))]
        for system in ("linux_x86_64", "linux_aarch64"):
            ends = f"{SYSTEMS[system][1]}.whl"
            sizes.append(f"{system} {max(_megabytes(u) for u in links if u.endswith(ends))}")
    else:
        about += (
            f"\n# Without hashes, because its index could not be reached: {TORCH_INDEX}"
            "\n# is the only source, since the registry has no versions with a +."
        )
        sizes.append("linux_x86_64 192")  # of torch 2.13.0 for Python 3.11
    text = f"{_head(about)}# megabytes: {', '.join(sizes)}\n" + " \\\n    ".join(lines) + "\n"
    _replace(FOLDER / "torch-cpu.txt", text)


def _index_links(version: str) -> dict[str, str]:
    """SHA-256 by URL of the Linux wheels in torch's own index."""
    try:
        with urllib.request.urlopen(f"{TORCH_INDEX}/torch/", timeout=60) as answer:
            page = answer.read().decode()
    except (urllib.error.URLError, TimeoutError) as error:
        raise SystemExit(
            f"{TORCH_INDEX} cannot be reached ({error}); run this with access to it, or with "
            "--without-torch-index."
        ) from error
    start, found = f"torch-{version}%2Bcpu-", {}
    for address, name, value in _LINK.findall(page):
        python = re.search(r"-cp3(\d+)-cp3\d+-", name)
        known = python is not None and (3, int(python[1])) in PYTHONS
        if known and name.startswith(start) and "linux" in name:
            found[urllib.parse.urljoin(f"{TORCH_INDEX}/torch/", address)] = value
    if not found:
        raise SystemExit(f"{TORCH_INDEX} has no hashes for torch {version} without CUDA.")
    return found


def _megabytes(address: str) -> int:
    request = urllib.request.Request(address, method="HEAD")
    with urllib.request.urlopen(request, timeout=60) as answer:
        return round(int(answer.headers["Content-Length"]) / 1e6)


def _head(about: str) -> str:
    return f"# {about}\n# Written by tools/build/renew_pins.py.\n"


def _replace(path: Path, text: str) -> None:
    partial = path.with_suffix(".partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
    print(f"{path.relative_to(ROOT)} written")


def main() -> int:
    """Resolve and write all lists."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--without-torch-index", action="store_true", help="see above")
    options = parser.parse_args()
    packages = resolve(requirements())
    with_torch = [p for p in packages if _WITH_TORCH.match(p["name"])]
    pip = [p for p in packages if p["name"] == "pip"]
    rest = [p for p in packages if p not in with_torch and p not in pip]
    (torch,) = [p["version"] for p in with_torch if p["name"] == "torch"]
    FOLDER.mkdir(exist_ok=True)
    write_cpu_torch(torch, hashes=not options.without_torch_index)
    write("torch.txt", "torch, and on Linux the CUDA that it needs.", with_torch)
    write("pip.txt", "pip itself.", pip)
    write("packages.txt", "Packages of training other than torch.", rest)
    return 0


if __name__ == "__main__":
    sys.exit(main())

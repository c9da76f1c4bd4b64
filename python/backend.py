"""Builds wheels and source distributions.

maturin compiles. A wheel further contains type stubs, which describe the compiled half, simulated sample data and all
licence texts. A source distribution contains the whole workspace, because the package depends on the crate at its root.

``pip install ./python``, ``pip wheel ./python`` and ``python -m build ./python`` run it.
"""

import io
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile

import maturin
from maturin import *  # noqa: F403  the other hooks

ROOT = pathlib.Path(__file__).resolve().parent.parent


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    """The hook of PEP 517: writes the wheel and returns its name."""
    name = maturin.build_wheel(wheel_directory, config_settings, metadata_directory)

    def python(*arguments, cwd=None):
        subprocess.run([sys.executable, "-B", *arguments], cwd=cwd, check=True, stdout=sys.stderr)

    with tempfile.TemporaryDirectory() as folder:
        python("-m", "wheel", "unpack", os.path.join(wheel_directory, name), "--dest", folder)
        (package,) = pathlib.Path(folder).iterdir()
        python("-m", "pwrfgs._stubs", cwd=package)
        python("-c", "from pwrfgs import datasets; datasets._make_sample()", cwd=package)
        (information,) = package.glob("*.dist-info")
        _add_licences(information)
        python("-m", "wheel", "pack", str(package), "--dest-dir", wheel_directory)
    return name


def build_sdist(sdist_directory, config_settings=None):
    """The hook of PEP 517: writes the source distribution and returns its name. It contains the files that git tracks."""
    version = re.search(r'^version = "(.*)"', (ROOT / "Cargo.toml").read_text(), re.MULTILINE)[1]
    folder = f"pwrfgs-{version}"
    listed = subprocess.run(["git", "ls-files", "-z", *_SOURCES], cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout

    with tarfile.open(os.path.join(sdist_directory, f"{folder}.tar.gz"), "w:gz") as archive:

        def add(name, text):
            entry = tarfile.TarInfo(f"{folder}/{name}")
            content = text.encode()
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))

        for path in filter(None, listed.decode().split("\0")):
            archive.add(ROOT / path, f"{folder}/{path}")
        # Read by the build script of this crate, as in a package of cargo.
        add("crates/experiment/.cargo_vcs_info.json", json.dumps({"git": {"sha1": commit.strip()}}, indent=1))
        settings = (ROOT / "python/pyproject.toml").read_text()
        for old, new in [
            ('backend-path = ["."]', 'backend-path = ["python"]'),
            ('readme = "README.md"', 'readme = "python/README.md"'),
            ('python-source = "."', 'python-source = "python"\nmanifest-path = "python/Cargo.toml"'),
        ]:
            assert settings.count(old) == 1, f"pyproject.toml has no {old}"
            settings = settings.replace(old, new)
        add("pyproject.toml", settings)
        with tempfile.TemporaryDirectory() as information:
            name = maturin.prepare_metadata_for_build_wheel(information)
            add("PKG-INFO", pathlib.Path(information, name, "METADATA").read_text(encoding="utf-8"))
    return f"{folder}.tar.gz"


#: Files and folders of the workspace in a source distribution.
_SOURCES = (
    ".cargo", "Cargo.lock", "Cargo.toml", "LICENSE-APACHE", "LICENSE-MIT", "benches", "crates", "experiments", "fuzz", "models",
    "pipelines", "python", "scenes", "src", "tests",
)  # fmt: skip


def _add_licences(information):
    """Add the licence texts of the project and of all compiled crates to the folder ``*.dist-info`` of a wheel."""
    folder = information / "licenses"
    folder.mkdir(exist_ok=True)
    names = ["LICENSE-APACHE", "LICENSE-MIT"]
    for name in names:
        shutil.copy(ROOT / name, folder)
    (folder / "LICENSE-THIRD-PARTY").write_text(third_party_licences(), encoding="utf-8")
    metadata = information / "METADATA"
    fields, separator, text = metadata.read_text(encoding="utf-8").partition("\n\n")
    lines = [f"License-File: {name}" for name in [*names, "LICENSE-THIRD-PARTY"]]
    fields = "\n".join(line for line in fields.splitlines() if line not in lines)  # maturin has found some of them
    metadata.write_text("\n".join([fields, *lines]) + separator + text, encoding="utf-8")


def third_party_licences():
    """Licence texts of the crates that are compiled into the package, each text once, after the crates that have it."""
    command = ["cargo", "metadata", "--format-version", "1", "--manifest-path", str(ROOT / "python/Cargo.toml")]
    features = re.findall(r"--features[= ](\S+)", os.environ.get("MATURIN_PEP517_ARGS", ""))
    command += ["--features", ",".join(features)]
    metadata = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    packages = {package["id"]: package for package in metadata["packages"]}
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    linked, waiting = set(), [metadata["resolve"]["root"]]
    while waiting:
        node = waiting.pop()
        if node not in linked:
            linked.add(node)
            normal = [dep for dep in nodes[node]["deps"] if any(kind["kind"] is None for kind in dep["dep_kinds"])]
            waiting += [dep["pkg"] for dep in normal]
    crates, texts = [], {}
    for package in sorted((packages[node] for node in linked), key=lambda package: package["name"]):
        if package["source"] is None:
            continue  # of this project
        name = f"{package['name']} {package['version']}"
        crates.append(f"{name}: {package['license']}")
        folder = pathlib.Path(package["manifest_path"]).parent
        for file in sorted(folder.iterdir()):
            if re.match("licen[cs]e|copying|notice|unlicense", file.name, re.IGNORECASE) and file.is_file():
                text = file.read_text(encoding="utf-8", errors="replace").strip()
                texts.setdefault(text, []).append(name)
    parts = [f"{', '.join(names)}\n\n{text}" for text, names in texts.items()]
    return ("\n\n" + "=" * 100 + "\n\n").join(["\n".join(crates), *parts]) + "\n"

"""Builds a wheel with maturin and adds the type stubs that its compiled half describes.

``pip install ./python`` and ``pip wheel ./python`` run it.
"""

import os
import subprocess
import sys
import tempfile

import maturin
from maturin import *  # noqa: F403  the other hooks


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    """The hook of PEP 517: writes the wheel and returns its name."""
    name = maturin.build_wheel(wheel_directory, config_settings, metadata_directory)

    def python(*arguments, cwd=None):
        subprocess.run([sys.executable, "-B", "-m", *arguments], cwd=cwd, check=True, stdout=sys.stderr)

    with tempfile.TemporaryDirectory() as folder:
        python("wheel", "unpack", os.path.join(wheel_directory, name), "--dest", folder)
        package = os.path.join(folder, *os.listdir(folder))
        python("pwrfgs._stubs", cwd=package)
        python("wheel", "pack", package, "--dest-dir", wheel_directory)
    return name

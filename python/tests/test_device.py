"""The device of the process: the list of GPUs, and the choice of one before the first computation."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

import pwrfgs
from conftest import SMALL

NETWORK = SMALL.replace("Factored(width: 16, depth: 1)", "Mlp(depth: 2, width: 16, skip: None)")
UNSUPPORTED = "this package was compiled without GPU support; install it with `MATURIN_PEP517_ARGS='--features gpu' pip install ./python`"


def call(code, software="1"):
    """Runs `code` in a process of its own, in which software GPUs are admitted; what it printed."""
    environment = {**os.environ, "PWRFGS_DEVICE_SOFTWARE": software, "XDG_RUNTIME_DIR": os.environ.get("XDG_RUNTIME_DIR", "/tmp")}
    done = subprocess.run(
        [sys.executable, "-c", f"import pwrfgs\nNETWORK = {NETWORK!r}\n{code}"],
        capture_output=True, text=True, env=environment, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def refused(code):
    """The message of the `InputError` that `code` raises after `NETWORK` computed what it needs."""
    return call(f"{code.partition('|')[0]}\ntry:\n    {code.partition('|')[2]}\nexcept pwrfgs.InputError as error:\n    print(error)")


@pytest.fixture(scope="module")
def gpus():
    """Names of the GPUs; skips where the package has no GPU support, or the machine no GPU."""
    try:
        found = pwrfgs.devices()
    except pwrfgs.InputError as error:
        pytest.skip(str(error))
    if not found:
        pytest.skip("no GPU here, nor Debian's mesa-vulkan-drivers and libvulkan1")
    return found


def test_unknown_device_is_refused():
    for device in ("GPU", "cuda:0", -1, 1.5, True):
        with pytest.raises(pwrfgs.InputError, match="use_device `.*`: expected cpu, gpu, auto, or a number from pwrfgs.devices"):
            pwrfgs.use_device(device)


def test_cpu_is_the_default_and_always_selectable():
    assert call("print(pwrfgs.use_device('cpu'))") == "CPU"
    assert pwrfgs.use_device("cpu") == "CPU"


def test_package_without_gpu_support_says_how_to_get_it():
    try:
        pwrfgs.devices()
    except pwrfgs.InputError as error:
        assert str(error) == f"devices: {UNSUPPORTED}, or use the CPU"
        for device in ("gpu", 0):
            with pytest.raises(pwrfgs.InputError) as caught:
                pwrfgs.use_device(device)
            assert str(caught.value) == f"use_device {device}: {UNSUPPORTED}, or use the CPU"
        assert pwrfgs.use_device("auto") == "CPU"
    else:
        pytest.skip("this package has GPU support")


def test_gpu_computes_and_names_itself_in_the_run(gpus, tmp_path):
    code = f"""
import json
assert pwrfgs.devices() == {gpus!r}
name = pwrfgs.use_device("gpu")
assert pwrfgs.use_device("gpu") == name and pwrfgs.use_device("auto") == name  # the same choice may be repeated
run = pwrfgs.run(pwrfgs.Pipeline(NETWORK), out={str(tmp_path / "r")!r}, progress=False)
assert run.model.predict([0.5, 0.5, 0.5]).shape == (15, 60)
assert json.load(open({str(tmp_path / "r/run.json")!r}))["machine"]["device"] == name
print(name)
"""
    assert gpus[0].startswith(call(code))
    assert call('print(pwrfgs.use_device("gpu"))') == call("print(pwrfgs.use_device(0))")


def test_device_is_refused_after_the_first_computation(gpus):
    computes = "trainer = pwrfgs.Trainer(pwrfgs.Pipeline(NETWORK)); trainer.step()|"
    settled = "this process computes on {}; select the device before the first computation"
    assert refused(f'{computes}pwrfgs.use_device("gpu")') == f"use_device gpu: {settled.format('the CPU')}"
    name = gpus[0].partition(", a software GPU")[0]
    assert refused(f'pwrfgs.use_device("gpu")|pwrfgs.use_device("cpu")') == f"use_device cpu: {settled.format(name)}"
    # Loading and describing compute nothing.
    assert call("pwrfgs.Pipeline(NETWORK).load_data()\nprint(pwrfgs.use_device('gpu'))") == name


def test_software_gpu_is_refused(gpus):
    if not all(name.endswith("a software GPU") for name in gpus):
        pytest.skip("this machine has a GPU")
    code = "try:\n    pwrfgs.use_device('gpu')\nexcept pwrfgs.InputError as error:\n    print(error)"
    message = call(code, software="0")
    assert message.startswith("use_device gpu: only ") and message.endswith(", a software GPU slower than the CPU, was found")


def test_number_beyond_the_list_is_refused(gpus):
    message = refused("|pwrfgs.use_device(99)")
    assert message.startswith("use_device 99: ") and message.endswith("found; see pwrfgs.devices()")

"""What a wheel contains besides the package: the program, sample data and licences. Runs on an installed wheel."""

from __future__ import annotations

import importlib.metadata
import pathlib
import signal
import subprocess

import pwrfgs

PROGRAM = str(pathlib.Path(pwrfgs.__file__).parents[1] / "bin/pwrfgs")
SHORT = ["--set", "data.samples=60", "--set", "data.points=500", "--set", "baselines=[MeanSpectrum()]"]


def program(folder, *arguments):
    return subprocess.run([PROGRAM, *arguments], cwd=folder, capture_output=True, text=True, timeout=300, check=False)


def test_console_script_runs_in_empty_folder(tmp_path):
    done = program(tmp_path, "run", "quickstart", "--scale", "0.004", *SHORT)
    assert done.returncode == 0, done.stderr
    assert "report: runs/quickstart/report.html" in done.stdout and (tmp_path / "runs/quickstart/report.html").is_file()
    model = pwrfgs.Model.load(tmp_path / "runs/quickstart")
    assert model.predict([3.5, 2.2, 1.2]).shape == (90, 360)
    wrong = program(tmp_path, "run", "quikstart")
    assert wrong.returncode == 2 and "did you mean `quickstart`?" in wrong.stderr and "Traceback" not in wrong.stderr
    assert program(tmp_path, "--version").stdout.startswith(f"pwrfgs {pwrfgs.__version__}")


def test_ctrl_c_stops_console_script(tmp_path):
    command = [PROGRAM, "run", "quickstart", *SHORT]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as child:
        assert child.stderr is not None
        assert any("step " in line for line in child.stderr)
        child.send_signal(signal.SIGINT)
        rest = child.stderr.read()
        assert child.wait(60) == 130 and "repeat the command to resume" in rest and "Traceback" not in rest, rest


def test_sample_is_simulated():
    data = pwrfgs.datasets.sample()
    assert len(data) == 60 and data.kind == "spectrum" and data.simulated and "simulated" in repr(data)
    assert data.spectra.shape == (60, 90, 360) and data.points.shape == (2000, 3)
    assert (data.spectra.std(axis=0) > 0).any()


def test_licences_of_all_compiled_crates_are_included():
    distribution = importlib.metadata.distribution("pwrfgs")
    names = distribution.metadata.get_all("License-File")
    assert names == ["LICENSE-APACHE", "LICENSE-MIT", "LICENSE-THIRD-PARTY"]
    texts = [distribution.read_text(f"licenses/{name}") or "" for name in names]
    assert "Apache License" in texts[0] and "Permission is hereby granted" in texts[1]
    assert all(f"\n{crate} " in texts[2] for crate in ("clap", "dfdx", "gemm", "libloading", "pyo3", "rayon", "ron", "wgpu"))

"""Snippets of the README for own powers and channels."""

from __future__ import annotations

import re

import numpy as np
import pytest
from conftest import ROOT

import pwrfgs

TX = np.random.default_rng(0).uniform((0, 0, 1), (4, 3, 1.5), (250, 3))


def snippet(word):
    """The code block that contains ``word``."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "python/README.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    return next(block for block in blocks if word in block)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    (tmp_path / "pipelines").symlink_to(ROOT / "pipelines")
    monkeypatch.chdir(tmp_path)


def test_received_powers():
    gateways = np.array([[0, 0, 2.5], [4, 3, 2.5]])
    rssi = -40 - 20 * np.log10(np.linalg.norm(TX[:, None] - gateways, axis=2))
    code = snippet("rssi=")
    assert '"training.scale": 0.1' in code
    names = {"pwrfgs": pwrfgs, "tx": TX, "rssi": rssi, "gateways": gateways}
    exec(code.replace('"training.scale": 0.1', '"training.scale": 0.005'), names)
    assert names["power"].shape == (2, 2) and np.isfinite(names["power"]).all()


def test_channels_with_a_bar_that_has_a_total(monkeypatch):
    bars = []

    class Bar:
        def __init__(self, total, desc, **settings):
            self.n, self.total = 0, total
            bars.append(self)
            self.desc = desc

        def update(self, n):
            self.n += n

        def set_postfix_str(self, *given, **settings):
            pass

        def close(self):
            pass

    monkeypatch.setattr("tqdm.auto.tqdm", Bar)
    monkeypatch.setattr(pwrfgs._run, "_is_interactive", lambda: True)
    hz, antennas = 5e7 + 5e6 * np.arange(3), [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)]
    distance = np.linalg.norm(TX[:, None] - np.add((4.0, 3.0, 2.9), antennas), axis=2)[..., None]
    names = {"pwrfgs": pwrfgs, "tx": TX, "hz": hz, "antennas": antennas, "csi": np.exp(-2j * np.pi * distance * hz / 299_792_458) / distance}
    exec(snippet("csi="), names)
    assert names["h"].shape == (2, 2, 3)
    search = [bar for bar in bars if bar.desc == "initialising"]
    assert search[-1].total == 1_600 and search[-1].n >= 1  # ten additions, five removals, the last refinement, in hundredths

"""`predict` of 10,000 positions against the library's own call, in turn, and what a call costs by itself.

    python python/benches/predict.py runs/x/model.safetensors

Wants a quiet machine, cargo, and some gigabytes: 10,000 spectra of 360 x 90 pixels are 1.3 GB.
"""

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import pwrfgs

path = Path(sys.argv[1]).resolve()
root = Path(__file__).resolve().parents[2]
model = pwrfgs.Model.load(path)
k = np.arange(10_000)
tx = np.stack([0.05 * (k % 100), 0.05 * (k // 100), np.full(10_000, 1.5)], axis=1)
model.predict(tx[:64])


def library() -> float:
    bench = ["cargo", "bench", "--quiet", "-p", "pwrfgs", "--bench", "many"]
    told = subprocess.run(bench, cwd=root, env={**os.environ, "PWRFGS_MODEL": str(path)}, check=True, stdout=subprocess.PIPE)
    return float(told.stdout.split()[-1])


def python() -> float:
    begun = time.perf_counter()
    model.predict(tx)
    return time.perf_counter() - begun


library()  # compiles
pairs = [(library(), python()) for _ in range(7)]
own, here = (statistics.median(times) for times in zip(*pairs))
print(f"10,000 positions: library {own:.3f} s, Python {here:.3f} s, ratio {here / own:.3f} (medians of 7)")

nowhere, rounds = tx[:0], 20_000
begun = time.perf_counter()
for _ in range(rounds):
    model.predict(nowhere)
print(f"a call, of no position at all: {(time.perf_counter() - begun) / rounds * 1e6:.2f} µs")

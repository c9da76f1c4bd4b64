"""Predictions: their shapes, their bits, and what is said when they are asked wrongly."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading

import numpy as np
import pytest
from conftest import interrupted

import pwrfgs


def test_one_place_and_many(model):
    places = np.array([[0.5, 0.2, 1.0], [1.0, -0.5, 1.2], [0.0, 0.1, 0.9]])
    many = model.predict(places)
    assert many.shape == (3, 15, 60) and many.dtype == np.dtype(f"float{8 * pwrfgs._pwrfgs.real_bytes}")
    assert many.flags.c_contiguous and many.flags.writeable
    for place, own in zip(places, many):
        assert np.array_equal(model.predict(place), own)
        assert np.array_equal(model.predict(list(place)), own)
    assert np.array_equal(model.predict(places.astype(np.float32).astype(np.float64)), model.predict(places.astype(np.float32)))


def test_derivative_by_position(model):
    places = np.array([[0.5, 0.2, 1.0], [1.0, -0.5, 1.2]])
    rng = np.random.default_rng(1)
    d = rng.normal(size=(2, 15, 60))
    found, slopes = model.predict(places, vjp=d)
    assert np.allclose(found, model.predict(places), atol=1e-6) and slopes.shape == (2, 3)
    one, slope = model.predict(places[0], vjp=d[0])
    assert one.shape == (15, 60) and np.allclose(slope, slopes[0], rtol=1e-5)
    step, moves = 1e-4, rng.normal(size=(2, 3))  # a ReLU turns within a millimetre
    value = [(model.predict(places + sign * step * moves) * d).sum() for sign in (1, -1)]
    assert np.isclose((value[0] - value[1]) / (2 * step), (slopes * moves).sum(), rtol=5e-2, atol=1e-2)
    with pytest.raises(pwrfgs.InputError, match=r"vjp has shape \[2, 15\], expected \[2, 15, 60\]"):
        model.predict(places, vjp=d[:, :, 0])


def test_arrays_as_they_come(model):
    places = np.random.default_rng(0).normal(size=(6, 3))
    want = model.predict(places)
    assert np.array_equal(model.predict(np.asfortranarray(places)), want)
    padded = np.zeros((6, 6))
    padded[:, ::2] = places
    assert np.array_equal(model.predict(padded[:, ::2]), want)
    fixed = places.copy()
    fixed.flags.writeable = False
    assert np.array_equal(model.predict(fixed), want)
    assert model.predict(np.empty((0, 3))).shape == (0, 15, 60)
    assert model.predict([[1, 2, 3]]).shape == (1, 15, 60)


@pytest.mark.parametrize(
    ("tx", "said"),
    [
        ([1.0, 2.0], "tx has shape [2], expected [3]"),
        (np.zeros((2, 4)), "tx has shape [2, 4]"),
        (np.zeros((2, 2, 3)), "tx has shape [2, 2, 3]"),
        (1.0, "expected"),
        ("here", "expected"),
        ([[1.0, 2.0, float("nan")]], "tx[0] is [1.0, 2.0, NaN]; give finite numbers"),
        ([0.0, float("inf"), 0.0], "give finite numbers"),
        (np.zeros((2, 3), complex), "tx holds complex128"),
        (np.array([["a", "b", "c"]]), "expected"),
        ([[object()] * 3], "tx holds object"),
        ([[1.0, 2.0, 3.0], [1.0]], "is not an array"),
        (None, "tx is missing"),
    ],
)
def test_what_is_no_position_is_refused(model, tx, said):
    with pytest.raises(pwrfgs.InputError) as told:
        model.predict(tx)
    assert said in str(told.value)
    assert isinstance(told.value, ValueError) and isinstance(told.value, pwrfgs.Error)


def test_the_same_bits_as_the_command_line(model, run, cli, tmp_path):
    places = np.random.default_rng(1).normal(size=(5, 3))
    table = tmp_path / "tx.csv"
    table.write_text("x,y,z\n" + "".join(f"{x!r},{y!r},{z!r}\n" for x, y, z in places.tolist()))
    command = [cli, "predict", f"{run.folder}/model.safetensors", "--tx-csv", str(table), "--out", str(tmp_path / "p"), "--no-png"]
    subprocess.run(command, check=True, capture_output=True)
    for i, place in enumerate(places):
        assert np.array_equal(np.load(tmp_path / "p" / f"{i + 1:05}.npy"), model.predict(place))


def test_ensembles_spread(run, model, tmp_path):
    model.save(tmp_path / "half.safetensors", half=True)
    pair = pwrfgs.Model.load(run.folder, tmp_path / "half.safetensors")
    place = [0.5, 0.2, 1.0]
    assert len(pair.members) == 2 and pair.n == 2 * model.n
    assert pair.spread(place).shape == (15, 60) and (0 <= pair.spread(place)).all() and (pair.spread(place) < 0.01).all()
    assert np.allclose(pair.predict(place), model.predict(place).clip(0, 1), atol=0.01)
    with pytest.raises(pwrfgs.InputError, match="are the same model"):
        pwrfgs.Model.load(run.folder, f"{run.folder}/model.safetensors")


def test_gaussians_and_files(model, tmp_path):
    gaussians = model.gaussians()
    n = model.n
    assert [a.shape for a in gaussians] == [(n, 3), (n, 4), (n, 3), (n,), (n,)]
    assert np.iscomplexobj(gaussians.signals) and (gaussians.scales > 0).all()
    assert ((gaussians.opacities > 0) & (gaussians.opacities < 1)).all()
    assert np.allclose(np.linalg.norm(gaussians.quats, axis=1), 1, atol=1e-5)
    there = model.gaussians(tx=[0.5, 0.2, 1.0])
    assert not np.array_equal(there.signals, gaussians.signals)
    model.save(tmp_path / "m.safetensors")
    model.save(tmp_path / "half.safetensors", half=True)
    again = pwrfgs.Model.load(tmp_path / "m.safetensors")
    assert np.array_equal(again.predict([1.0, 0, 1]), model.predict([1.0, 0, 1]))
    assert (tmp_path / "half.safetensors").stat().st_size < (tmp_path / "m.safetensors").stat().st_size
    model.to_ply(tmp_path / "m.ply")
    assert (tmp_path / "m.ply").read_bytes().startswith(b"ply\n")
    with pytest.raises(pwrfgs.InputError, match="invalid member index 3"):
        model.gaussians(member=3)
    with pytest.raises(pwrfgs.Error, match="none.safetensors"):
        pwrfgs.Model.load(tmp_path / "none.safetensors")
    (tmp_path / "junk.safetensors").write_bytes(b"junk")
    with pytest.raises(pwrfgs.InputError) as told:
        pwrfgs.Model.load(tmp_path / "junk.safetensors")
    (tmp_path / "sweep.json").write_text('{"name": "x", "runs": [{"folder": "seed=0", "labels": [], "seed": 0}]}')
    with pytest.raises(pwrfgs.InputError, match="name one of its runs: seed=0"):
        pwrfgs.Model.load(tmp_path)
    assert told.value.path == str(tmp_path / "junk.safetensors")


def test_two_threads_predict_at_once(model):
    places = np.random.default_rng(2).normal(size=(200, 3))
    want, found = model.predict(places), {}
    threads = [threading.Thread(target=lambda k=k: found.update({k: model.predict(places)})) for k in range(4)]
    [thread.start() for thread in threads]
    [thread.join(60) for thread in threads]
    assert len(found) == 4 and all(np.array_equal(own, want) for own in found.values())


def test_others_run_while_it_predicts(model):
    ticks, stop = [], threading.Event()

    def tick():
        while not stop.is_set():
            ticks.append(0)
            stop.wait(0.001)

    ticker = threading.Thread(target=tick)
    ticker.start()
    model.predict(np.random.default_rng(3).normal(size=(3000, 3)))
    stop.set()
    ticker.join()
    assert len(ticks) > 5


def resident() -> int:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE")


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="memory is told by Linux only")
def test_memory_does_not_grow(model):
    place = np.array([0.5, 0.2, 1.0])
    for _ in range(200):
        model.predict(place)
        model.gaussians()
    gc.collect()
    before = resident()
    for _ in range(1000):
        model.predict(place)
        model.gaussians()
    gc.collect()
    assert resident() - before < 4 << 20


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_forked_child_is_told_and_does_not_hang(run):
    code = f"""
import os, signal, pwrfgs
model = pwrfgs.Model.load({run.folder!r})
model.predict([0.5, 0.2, 1.0])
child = os.fork()
if child == 0:
    signal.alarm(20)
    try:
        model.predict([[0.5, 0.2, 1.0]] * 100)
        os._exit(1)
    except RuntimeError as error:
        os._exit(0 if "spawn" in str(error) else 2)
raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0


def test_more_than_there_is_memory_for(model):
    with pytest.raises(MemoryError, match="fewer at a time"):
        model.predict(np.zeros((20_000_000, 3)))
    with pytest.raises(pwrfgs.InputError, match="finite"):
        model.gaussians([np.nan, 0, 0])


def test_ctrl_c_ends_a_long_prediction(run):
    code = (
        "import numpy as np, pwrfgs, sys\n"
        "model = pwrfgs.Model.load(sys.argv[1]); print('there', flush=True)\n"
        "try:\n    place = np.zeros((20000, 3))\n    while True: model.predict(place)\n"
        "except KeyboardInterrupt: print('stopped', flush=True)\n"
    )
    # CPython 3.11 does not catch what is raised where a loop begins anew if the loop is the first statement of its `try`.
    assert interrupted(code, run.folder, after=0.5) == "stopped\n"


@pytest.mark.skipif(sys.platform != "linux", reason="reads the peak memory in /proc")
def test_batches_bound_the_memory_of_many_predictions():
    """The whole result has 389 MB; in batches, the process grows by less than 100 MB."""
    code = """
import numpy as np, pwrfgs
tx = np.random.default_rng(0).uniform(0, 4, (3000, 3))
model = pwrfgs.Model.from_arrays(
    tx[:2], np.tile([1.0, 0, 0, 0], (2, 1)), np.full((2, 3), 0.2), [0.5, 0.5], [0.5, 0.5], pwrfgs.Pose((2, 2, 0))
)

def peak():
    return int(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]) / 1024

model.predict(tx[:100])
before = peak()
count = sum(len(spectra) for spectra in model.predict(tx, batch_size=100))
batches = peak()
whole = model.predict(tx)
print(count, batches - before, peak() - before, whole.nbytes / 1024**2)
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=120)
    count, batches, whole, array = map(float, done.stdout.split())
    assert count == 3000 and batches < 100 and array / 1.05 < whole < array + 100


def test_batches_have_the_bits_of_one_call(model, caplog):
    places = np.random.default_rng(0).normal(size=(7, 3))
    batches = list(model.predict(places, batch_size=3))
    assert [len(batch) for batch in batches] == [3, 3, 1]
    assert np.array_equal(np.concatenate(batches), model.predict(places))
    assert list(model.predict(places[:0], batch_size=3)) == []
    caplog.clear()
    list(model.predict(places + 60, batch_size=3))
    assert [record.getMessage()[:16] for record in caplog.records] == ["7 of 7 predictio"]  # one warning for all
    for arguments, problem in [
        (dict(tx=places, batch_size=0), "batch_size is 0, expected 1 or more"),
        (dict(tx=places[0], batch_size=3), "batch_size needs one position per row"),
        (dict(tx=places, batch_size=3, vjp=np.zeros((7, 15, 60))), "give one of vjp and batch_size"),
        (dict(tx=places[:, :2], batch_size=3), "tx has shape"),
        (dict(batch_size=3), "tx is missing"),
        (dict(tx=places, features=places), "this model takes only tx"),
    ]:
        with pytest.raises(pwrfgs.InputError) as error:
            model.predict(**arguments)
        assert problem in str(error.value)


def test_models_of_the_package_need_no_data(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = pwrfgs.load("s23")
    spectra = model.predict(model.training_positions[:2])
    assert spectra.shape == (2, 90, 360) and spectra.max() > 0.5 and len(model.gaussians().means) == 157
    assert model.locate(spectra.clip(0, 1)).positions.shape == (2, 3)
    powers = pwrfgs.load("ble")
    assert powers.predict(powers.training_positions[0]).shape == (21,)
    channels = pwrfgs.load("office-channel")
    assert channels.predict(channels.training_positions[0]).shape == (16, 16)
    with pytest.raises(pwrfgs.InputError, match="did you mean `s23`"):
        pwrfgs.load("s32")
    channels.save("s23")
    assert len(pwrfgs.load("s23").gaussians().means) != 157, "a file of this name is used first"

"""Loops of one's own: Gaussians, losses and networks that end in a model, a report and a checkpoint."""

from __future__ import annotations

import pickle
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import SMALL
from gaussians import POSE, gaussians
from networks import Plane, Swelling, squared

import pwrfgs

SIZE = dict(height=15, width=60)
UNCONSTRAINED = dict(
    means=np.zeros((2, 3)), log_scales=np.zeros((2, 3)), quats=np.ones((2, 4)), opacity_logits=np.zeros(2), signals=np.zeros((2, 2))
)


def waves(seed=0):
    given = gaussians(seed)
    return {**given, "signals": given["signals"] @ [1, 1j]}


def steps(trainer, count):
    return [trainer.step()["loss"] for _ in range(count)]


@pytest.mark.parametrize("readout", ["Magnitude", "Power", pwrfgs.settings.Readout.MinMax])
def test_model_of_arrays_predicts_what_the_kernels_render(readout, tmp_path):
    model = pwrfgs.Model.from_arrays(**waves(), pose=POSE, **SIZE, readout=readout)
    amplitude = np.abs(pwrfgs.rasterize(**waves(), pose=POSE, **SIZE))
    want = {"Magnitude": amplitude, "Power": amplitude**2}.get(str(readout))
    want = (amplitude - amplitude.min()) / np.ptp(amplitude) if want is None else want
    assert np.allclose(model.predict([1.0, 2.0, 3.0]), want, atol=1e-5) and want.max() > 0.05
    found = model.gaussians()
    for name, values in waves().items():
        own = getattr(found, name)
        values = values / np.linalg.norm(values, axis=1, keepdims=True) if name == "quats" else values
        assert np.allclose(own, values, atol=1e-5), name
    model.save(tmp_path / "m.safetensors")
    assert np.array_equal(pwrfgs.Model.load(tmp_path / "m.safetensors").predict([0, 0, 0]), model.predict([0, 0, 0]))


def test_model_of_arrays_far_from_zero():
    far = np.array([5e6, 4e5, 100.0])
    given = {**waves(), "means": waves()["means"] + far}
    pose = pwrfgs.Pose(tuple(far + POSE.position), POSE.orientation)
    model = pwrfgs.Model.from_arrays(**given, pose=pose, **SIZE, tx=[far, far + 1])
    assert np.allclose(model.predict(far), np.abs(pwrfgs.rasterize(**waves(), pose=POSE, **SIZE)), atol=1e-4)
    assert np.allclose(model.training_positions, [far, far + 1])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"scales": np.zeros((6, 3))}, "scales: give metres above 0"),
        ({"opacities": np.ones(6)}, "opacities: give numbers from 0 to below 1"),
        ({"quats": np.zeros((6, 4))}, "quats has a row of zeros"),
        ({"signals": np.zeros(5)}, r"signals has shape \[5\], expected \[6\]"),
        ({"means": np.full((6, 3), np.nan)}, "means has a number that is not finite"),
        ({"means": [1, 2]}, r"means has shape \[2\], expected \[N, 3\]"),
        ({"pose": 3}, "pose is 3"),
        ({"readout": "Magnitud"}, "Magnitude"),
        ({"weights": {"a": [1.0]}}, "no tensor `a`"),
        ({"deformation": "Fixd"}, "did you mean `Fixed`"),
        ({"height": 0}, "pixels"),
    ],
)
def test_model_of_arrays_rejects_invalid_input(change, said):
    with pytest.raises(pwrfgs.InputError, match=said):
        pwrfgs.Model.from_arrays(**{**waves(), "pose": POSE, **SIZE, **change})


def test_compressed_model_predicts_nearly_the_same(model, run, cli, tmp_path):
    whole = Path(run.folder) / "model.safetensors"
    for bits in ("8", "16"):
        small = tmp_path / f"{bits}.safetensors"
        subprocess.run([cli, "compress", whole, "--out", small, "--bits", bits], check=True)
        assert small.stat().st_size < 0.8 * whole.stat().st_size
        again, tx = pwrfgs.Model.load(small), run.pipeline.load_data().tx[:20]
        assert np.abs(again.predict(tx) - model.predict(tx)).max() < 0.02


def test_model_is_pickled_with_all_its_bits(model, run, tmp_path):
    again = pickle.loads(pickle.dumps(model))
    assert np.array_equal(again.predict([0.5, 0.2, 1.0]), model.predict([0.5, 0.2, 1.0]))
    model.save(tmp_path / "half.safetensors", half=True)
    pair = pwrfgs.Model.load(run.folder, tmp_path / "half.safetensors")
    assert pickle.loads(pickle.dumps(pair)).members == pair.members
    pair.save(tmp_path / "pair.safetensors")
    assert pwrfgs.Model.load(tmp_path / "pair.safetensors").members == pair.members
    with pytest.raises(pwrfgs.InputError):
        pwrfgs.Model._from_bytes(b"junk")


def test_own_model_ends_in_report_and_comparison(run, model, cli, tmp_path):
    own = pwrfgs.evaluate(pickle.loads(pickle.dumps(model)), SMALL, out=tmp_path / "own", progress=False)
    assert own.finished and own.scores["model"]["ssim"] == pytest.approx(run.scores["model"]["ssim"])
    assert "trained outside of this run" in str(own) and own.facts["steps"] == 0
    assert (tmp_path / "own/report.html").stat().st_size > 10_000
    assert "trained outside" in (tmp_path / "own/report.html").read_text(encoding="utf-8")
    assert "own" in pwrfgs.report([own, run], out=tmp_path / "compared")
    page = subprocess.run([cli, "view", own.folder, "--save", str(tmp_path / "room.html")], capture_output=True, text=True)
    assert page.returncode == 0, page.stderr
    again = pwrfgs.evaluate(model, SMALL, out=tmp_path / "own", progress=False)
    assert again.facts == own.facts
    kriged = SMALL.replace("Random(test: 0.2)", "Random(test: 0.2), residuals: Kriged()")
    fitted = [pwrfgs.evaluate(model, kriged, out=tmp_path / "kriged", progress=False) for _ in range(2)]
    assert fitted[0].facts == fitted[1].facts
    with_residuals = pwrfgs.Model.load(tmp_path / "kriged/model.safetensors")
    pwrfgs.evaluate(with_residuals, SMALL, out=tmp_path / "whole", progress=False)
    with pytest.raises(pwrfgs.InputError, match="holds another run"):
        pwrfgs.evaluate(model, SMALL, out=tmp_path / "whole", progress=False)
    other = pwrfgs.Model.from_arrays(**waves(), pose=pwrfgs.Pose(), **SIZE)
    with pytest.raises(pwrfgs.InputError, match="holds another run"):
        pwrfgs.evaluate(other, SMALL, out=tmp_path / "own", progress=False)
    with pytest.raises(pwrfgs.InputError):
        pwrfgs.evaluate(pwrfgs.Model.from_arrays(**waves(), pose=POSE), SMALL, out=tmp_path / "size", progress=False)
    assert not (tmp_path / "size").exists()


def test_gaussians_of_ones_own_are_trained_and_pruned(pipeline, dataset):
    trainer = pwrfgs.Trainer(pipeline, dataset)
    steps(trainer, 3)
    cloud, weight = trainer.cloud, trainer.stats.weight
    cloud.columns["means"] = cloud.means + 0.5
    trainer.set_cloud(cloud)
    assert np.array_equal(trainer.cloud.means, cloud.means) and np.array_equal(trainer.stats.weight, weight)
    trainer.set_cloud(pwrfgs.Gaussians(**waves()))
    assert len(trainer.cloud) == 6 and np.allclose(trainer.cloud.scales, waves()["scales"], rtol=1e-5)
    assert (trainer.stats.visible == 0).all()
    assert np.isfinite(steps(trainer, 2)).all() and trainer.prune(np.arange(6) < 4) == 4
    assert trainer.model().n == 4
    trainer.set_cloud(trainer.model().gaussians()._asdict())
    assert len(trainer.cloud) == 4


@pytest.mark.parametrize(
    ("cloud", "said"),
    [
        (3, "cloud is a int"),
        ({"means": np.zeros((2, 3))}, "cloud lacks quats, scales"),
        ({"means": np.zeros((2, 3)), "log_scales": np.zeros((2, 3))}, "cloud lacks quats, opacity_logits"),
        ({**{name: values[:0] for name, values in waves().items()}}, "0 Gaussians"),
        ({**UNCONSTRAINED, "log_scales": np.zeros((3, 2))}, r"log_scales has shape \[3, 2\], expected \[2, 3\]"),
        ({**UNCONSTRAINED, "opacity_logits": np.zeros((2, 1))}, r"opacity_logits has shape \[2, 1\], expected \[2\]"),
    ],
)
def test_set_cloud_rejects_invalid_input(pipeline, dataset, cloud, said):
    with pytest.raises(pwrfgs.InputError, match=said):
        pwrfgs.Trainer(pipeline, dataset).set_cloud(cloud)


def test_columns_of_pruners_are_kept_or_start_anew(pipeline, dataset):
    pipeline.pruners = [pwrfgs.LearnableMask(lambda_=0.01)]
    trainer = pwrfgs.Trainer(pipeline, dataset)
    steps(trainer, 5)
    name = next(name for name in trainer.cloud if name not in ("means", "log_scales", "quats", "opacity_logits", "signals"))
    learned = trainer.cloud[name]
    plain = {key: trainer.cloud[key] for key in ("means", "log_scales", "quats", "opacity_logits", "signals")}
    trainer.set_cloud(pwrfgs.Cloud(plain))
    assert np.array_equal(trainer.cloud[name], learned) and np.ptp(learned) > 0
    trainer.set_cloud(pwrfgs.Cloud({key: values[:9] for key, values in plain.items()}))
    assert np.ptp(trainer.cloud[name]) == 0 and len(trainer.cloud) == 9
    with pytest.raises(pwrfgs.InputError, match="unknown column `other`"):
        trainer.set_cloud(pwrfgs.Cloud({**plain, "other": np.zeros(len(learned))}))


def test_checkpoint_continues_with_the_same_bits(pipeline, dataset, tmp_path):
    trainer = pwrfgs.Trainer(pipeline, dataset)
    steps(trainer, 12)
    trainer.save_checkpoint(tmp_path / "c.safetensors")
    again = pwrfgs.Trainer.load(tmp_path / "c.safetensors", pipeline, dataset)
    assert again.done == 12 and steps(again, 15) == steps(trainer, 15)
    assert all(np.array_equal(again.cloud[name], trainer.cloud[name]) for name in trainer.cloud)
    with pytest.raises(pwrfgs.InputError, match="other settings, other data or another split"):
        pwrfgs.Trainer.load(tmp_path / "c.safetensors", pipeline, dataset, train=range(40))
    with pytest.raises(pwrfgs.Error, match=r"none\.safetensors"):
        pwrfgs.Trainer.load(tmp_path / "none.safetensors", pipeline, dataset)


def test_checkpoint_of_a_run_continues_in_a_trainer(run, pipeline):
    trainer = pwrfgs.Trainer.load(f"{run.folder}/checkpoint.safetensors", pipeline)
    assert trainer.finished and trainer.model().n == run.model.n


def test_own_loss_takes_the_place_of_that_of_the_pipeline(pipeline, dataset):
    calls = []

    def loss(predictions, truths):
        calls.append((predictions.shape, truths.shape))
        return squared(predictions, truths)

    pipeline.training.loss = dict(ssim_weight=0.0, pixel=pwrfgs.settings.PixelLoss.Squared)
    own, theirs = pwrfgs.Trainer(pipeline, dataset, loss=loss), pwrfgs.Trainer(pipeline, dataset)
    assert np.allclose(steps(own, 10), steps(theirs, 10), rtol=1e-3)
    assert np.allclose(own.cloud.means, theirs.cloud.means, atol=1e-3) and calls[0] == ((4, 15, 60),) * 2


def test_own_loss_of_channels_is_complex(tmp_path):
    rng = np.random.default_rng(0)
    tx, hz = rng.uniform((0, 0, 1), (4, 3, 1.5), (40, 3)), 5e7 + 5e6 * np.arange(3)
    distance = np.linalg.norm(tx - (4, 3, 2.9), axis=1)[:, None, None]
    csi = (np.exp(-2j * np.pi * distance * hz / 299_792_458) / distance) * np.ones((1, 2, 1))
    receiver = pwrfgs.Receiver(position=(4.0, 3.0, 2.9), antennas=[(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)])
    data = pwrfgs.Dataset.from_arrays(tx, csi=csi, frequencies_hz=hz, receivers=receiver)
    data.save(tmp_path / "csi")
    pipeline = pwrfgs.Pipeline(
        name="c", data=data, split=pwrfgs.Random(test=0.2), initializer=pwrfgs.Random(count=20, std=2.0),
        deformation=pwrfgs.Fixed(), training=dict(steps=4, batch=4, densify_until=0, prune_until=0),
    )
    energy = (np.abs(csi[data.split(pwrfgs.Random(test=0.2)).train]) ** 2).sum((1, 2)).mean()

    def loss(predictions, truths):
        assert predictions.dtype == csi.astype(predictions.dtype).dtype and predictions.shape[1:] == (2, 3)
        error, share = predictions - truths, 1 / (len(truths) * energy)
        return float(share * (np.abs(error) ** 2).sum()), 2 * share * error

    own, theirs = pwrfgs.Trainer(pipeline, data, loss=loss), pwrfgs.Trainer(pipeline, data)
    assert np.allclose(steps(own, 4), steps(theirs, 4), rtol=1e-2)


@pytest.mark.parametrize(
    ("loss", "said"),
    [
        ("L1", "loss is 'L1'; give a function"),
        (lambda p, t: 3.0, r"loss: expected \(number, derivative"),
        (lambda p, t: (1.0, np.zeros(3)), r"loss: the derivative has shape \[3\], expected \[4, 15, 60\]"),
        (lambda p, t: (1.0, np.zeros_like(p).transpose(0, 2, 1)), r"has shape \[4, 60, 15\], expected \[4, 15, 60\]"),
        (lambda p, t: (np.zeros(1), np.zeros_like(p)), r"loss: the value has shape \[1\], expected \[\]"),
        (lambda p, t: (float("nan"), np.zeros_like(p)), "holds NaN"),
        (lambda p, t: 1 / 0, "division by zero"),
    ],
)
def test_invalid_loss_is_reported(pipeline, dataset, loss, said):
    with pytest.raises((pwrfgs.InputError, ZeroDivisionError), match=said):
        pwrfgs.Trainer(pipeline, dataset, loss=loss).step()


@pytest.mark.parametrize("network", [Plane(seed=1), Swelling()])
def test_own_network_has_the_derivatives_that_training_uses(network):
    rng = np.random.default_rng(0)
    weights, means, tx = network.weights(), rng.normal(size=(5, 3)), rng.normal(size=(2, 3))
    ((name, term),) = network.forward(weights, means, tx).items()
    d = rng.normal(size=term.shape)
    slopes, _ = network.vjp(weights, means, tx, {name: d})
    for tensor, values in weights.items():
        change = rng.normal(size=values.shape)
        up, down = ({**weights, tensor: values + sign * 1e-5 * change} for sign in (1, -1))
        value = [(network.forward(w, means, tx)[name] * d).sum() for w in (up, down)]
        assert np.isclose((value[0] - value[1]) / 2e-5, (slopes[tensor] * change).sum(), rtol=1e-6), tensor


def test_own_network_is_trained_resumed_and_saved(pipeline, tmp_path):
    pipeline.deformation = Plane(seed=2)
    pipeline.training.steps = 60
    run = pwrfgs.run(pipeline, out=tmp_path / "plane", progress=False)
    loss = run.curve["loss"]
    assert loss[-10:].mean() < 0.8 * loss[:10].mean()
    model, where = run.model, [[0.5, 0.2, 1.0], [1.0, -0.4, 0.8]]
    there = model.predict(where)
    assert not np.allclose(there[0], there[1])
    assert np.array_equal(pickle.loads(pickle.dumps(model)).predict(where), there)
    assert pwrfgs.run(pipeline, out=tmp_path / "plane", progress=False).finished
    weights = {name: values for name, values in Plane(seed=2).weights().items()}
    own = pwrfgs.Model.from_arrays(**waves(), pose=POSE, **SIZE, deformation=Plane(seed=2), weights=weights)
    tx = np.array([0.3, 0.4, 1.0])
    signals = waves()["signals"] + Plane().forward(weights, waves()["means"], tx[None])["signals"][0] @ [1, 1j]
    want = np.abs(pwrfgs.rasterize(**{**waves(), "signals": signals}, pose=POSE, **SIZE))
    assert np.allclose(own.predict(tx), want, atol=1e-5)
    own.save(tmp_path / "own.safetensors")
    assert np.array_equal(pwrfgs.Model.load(tmp_path / "own.safetensors").predict(tx), own.predict(tx))


class Turned(Plane):
    """Returns what `turn` makes of the result of one method."""

    turn = {}

    def weights(self):
        return super().weights()

    def forward(self, weights, means, tx):
        return self.turn.get("forward", lambda found: found)(super().forward(weights, means, tx))

    def vjp(self, weights, means, tx, cotangents):
        return self.turn.get("vjp", lambda found: found)(super().vjp(weights, means, tx, cotangents))


@pytest.mark.parametrize(
    ("method", "turn", "said"),
    [
        ("forward", lambda d: {"signals": d["signals"].transpose(1, 0, 2)}, r"`signals` has shape \[60, 4, 2\], expected \[4, 60, 2\]"),
        ("forward", lambda d: {"signal": d["signals"]}, "forward: unknown term `signal`; did you mean `signals`"),
        ("vjp", lambda d: ({**d[0], "tx": d[0]["tx"].T}, d[1]), r"vjp: `tx` has shape \[2, 3\], expected \[3, 2\]"),
        ("vjp", lambda d: (d[0], d[1].T), r"the derivative in the centres has shape \[3, 60\], expected \[60, 3\]"),
        ("vjp", lambda d: ({**d[0], "tz": d[0]["tx"]}, d[1]), "vjp: unknown tensor `tz`; did you mean `tx`"),
        ("vjp", lambda d: ({"tx": d[0]["tx"]}, d[1]), "vjp: `centre` is missing"),
        ("vjp", lambda d: d[0], "vjp: expected"),
    ],
)
def test_shapes_and_names_of_own_network_are_compared(pipeline, dataset, monkeypatch, method, turn, said):
    monkeypatch.setattr(Turned, "turn", {method: turn})
    pipeline.deformation = Turned()
    with pytest.raises(pwrfgs.InputError, match=said):
        steps(pwrfgs.Trainer(pipeline, dataset), 1)


def test_own_loss_of_channels_compares_shapes_and_numbers(tmp_path):
    rng = np.random.default_rng(0)
    tx = rng.uniform((0, 0, 1), (4, 3, 1.5), (10, 3))
    csi = rng.normal(size=(10, 2, 3)) + 1j * rng.normal(size=(10, 2, 3))
    receiver = pwrfgs.Receiver(antennas=[(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)])
    data = pwrfgs.Dataset.from_arrays(tx, csi=csi, frequencies_hz=5e7 + 5e6 * np.arange(3), receivers=receiver)
    data.save(tmp_path / "csi")
    pipeline = pwrfgs.Pipeline(
        name="c", data=data, split=pwrfgs.Random(test=0.2), initializer=pwrfgs.Random(count=5, std=2.0), deformation=pwrfgs.Fixed(),
        training=dict(steps=4, batch=4, densify_until=0, prune_until=0),
    )
    for slope, said in [
        (lambda p: p.transpose(0, 2, 1), r"has shape \[4, 3, 2\], expected \[4, 2, 3\]"),
        (lambda p: np.full_like(p, np.nan), "the derivative holds NaN"),
    ]:
        with pytest.raises(pwrfgs.InputError, match=said):
            pwrfgs.Trainer(pipeline, data, loss=lambda p, t, slope=slope: (1.0, slope(p))).step()


def test_network_that_changes_scales_is_trained(pipeline, dataset):
    pipeline.deformation = Swelling()
    assert np.isfinite(steps(pwrfgs.Trainer(pipeline, dataset), 4)).all()


def test_program_names_the_network_that_it_lacks(cli, tmp_path):
    model = pwrfgs.Model.from_arrays(**waves(), pose=POSE, **SIZE, deformation=Plane())
    model.save(tmp_path / "m.safetensors")
    command = [cli, "predict", str(tmp_path / "m.safetensors"), "--tx", "0,0,1", "--out", str(tmp_path / "p")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2 and "`Plane` of the module `networks` is written in Python" in done.stderr, done.stderr

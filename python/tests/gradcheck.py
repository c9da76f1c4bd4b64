"""`pwrfgs.torch`: types in both builds, and in the one of double precision against central differences, by PyTorch's own check.
Runs without pytest, for the Python that has torch may be another than the one of the other tests."""

import pathlib
import sys
import tempfile

import numpy as np
import torch

import pwrfgs.torch
from gaussians import POSE, gaussians

REAL, COMPLEX = (torch.float64, torch.complex128) if pwrfgs._pwrfgs.real_bytes == 8 else (torch.float32, torch.complex64)


def tensors(seed, waves=False, dtype=REAL):
    """The columns of a few Gaussians, which want gradients; signals are complex if they are waves."""
    given = gaussians(seed)
    given["signals"] = given["signals"] @ [1, 1j] if waves else given["signals"]
    types = {"signals": {torch.float32: torch.complex64}.get(dtype, COMPLEX) if waves else dtype}
    return {name: torch.tensor(x).to(types.get(name, dtype)).requires_grad_() for name, x in given.items()}


def refused(change, words):
    given = {**tensors(3), **change}
    try:
        pwrfgs.torch.rasterize(**given, pose=POSE, height=12, width=48)
    except pwrfgs.InputError as error:
        assert words in str(error), error
    else:
        raise AssertionError(f"{words}: not refused")


def complex_signals_are_those_of_numpy():
    given = tensors(3, waves=True)
    picture = pwrfgs.torch.rasterize(**given, pose=POSE, height=12, width=48)
    arrays = {name: x.detach().numpy() for name, x in given.items()}
    want, vjp = pwrfgs.rasterize_with_vjp(**arrays, pose=POSE, height=12, width=48)
    assert picture.dtype == COMPLEX and picture.shape == (12, 48) and np.array_equal(picture.detach().numpy(), want)
    picture.abs().square().sum().backward()
    for (name, x), found in zip(given.items(), vjp(2 * want)):
        assert x.grad.dtype == x.dtype and np.allclose(x.grad.numpy(), found, rtol=1e-4, atol=1e-6), name
    assert given["signals"].grad.imag.abs().sum() > 0
    # A lazy conjugate is a view without numbers of its own.
    turned = pwrfgs.torch.rasterize(**{**given, "signals": given["signals"].detach().conj()}, pose=POSE, height=12, width=48)
    assert np.allclose(turned.detach().numpy(), want.conj())
    pwrfgs.torch.rasterize(**given, pose=POSE, height=12, width=48).conj().imag.sum().backward()


def gradients_have_the_types_of_their_tensors():
    single = tensors(3, dtype=torch.float32)
    pwrfgs.torch.rasterize(**single, pose=POSE, height=12, width=48).square().mean().backward()
    for name, x in single.items():
        assert x.grad is not None and x.grad.shape == x.shape and x.grad.dtype == x.dtype, name
        assert np.isfinite(x.grad.numpy()).all() and x.grad.abs().sum() > 0, name


def what_cannot_be_computed_is_refused():
    plain = tensors(3)
    if REAL == torch.float32:
        refused({"means": plain["means"].double()}, "means: unsupported type torch.float64")
        refused({"signals": plain["signals"].double()}, "use signals.to(torch.float32)")
        refused({"signals": plain["signals"].to(torch.complex128)}, "use signals.to(torch.complex64)")
    refused({"scales": plain["scales"].half()}, "scales: unsupported type torch.float16")
    refused({"means": plain["means"].to(COMPLEX)}, "means: unsupported type")
    refused({"opacities": [0.5] * 6}, "opacities: unsupported type list")
    picture = pwrfgs.torch.rasterize(**plain, pose=POSE, height=12, width=48)
    (slope,) = torch.autograd.grad(picture.square().sum(), plain["means"], create_graph=True)
    try:
        slope.square().sum().backward()
    except RuntimeError as error:
        assert "no second derivative" in str(error), error
    else:
        raise AssertionError("a second derivative did not raise an error")


def derivatives_are_central_differences():
    for waves, rasterizer in [(False, "AlphaBlending"), (False, "ArrayResponse"), (True, "AlphaBlending"), (True, "ArrayResponse")]:

        def picture(*given, rasterizer=rasterizer):
            return pwrfgs.torch.rasterize(*given, POSE, 12, 48, rasterizer=rasterizer)

        given = list(tensors(3, waves).values())
        assert torch.autograd.gradcheck(picture, given, eps=1e-7, atol=1e-4, rtol=1e-3, nondet_tol=0)


def predictions_are_differentiable():
    def model(deformation):
        given = gaussians(4)
        given["signals"] = given["signals"] @ [1, 1j]
        return pwrfgs.Model.from_arrays(**given, pose=POSE, height=12, width=48, deformation=deformation)

    octaves = pwrfgs.settings.Encoding.Octaves(1)
    network = pwrfgs.Factored(depth=1, width=8, position_encoding=octaves, tx_encoding=octaves)
    places = torch.tensor([[0.4, -0.2, 0.9], [1.2, 0.3, 0.7]], dtype=torch.float64, requires_grad=True)
    mine = model(network)
    found = pwrfgs.torch.predict(mine, places)
    assert found.dtype == REAL and np.array_equal(found.detach().numpy(), mine.predict(places.detach().numpy()))
    (slope,) = torch.autograd.grad(found.square().sum(), places)
    assert slope.dtype == torch.float64 and slope.shape == (2, 3) and slope.abs().min() > 0
    (alone,) = torch.autograd.grad(pwrfgs.torch.predict(mine, places[1].float(), 0).square().sum(), places)
    assert torch.allclose(alone[1], slope[1], rtol=1e-4) and alone[0].abs().sum() == 0
    if REAL == torch.float64:
        assert torch.autograd.gradcheck(lambda tx: pwrfgs.torch.predict(mine, tx), [places], eps=1e-6, atol=1e-4, rtol=1e-3)
    for refused_call, words in (
        (lambda: pwrfgs.torch.predict(mine, places[:, :2]), "tx has shape [2, 2], expected [3] or [B, 3]"),
        (lambda: pwrfgs.torch.predict(mine, places.half()), "tx: unsupported type torch.float16"),
        (lambda: pwrfgs.torch.predict(model(Net()), places).sum().backward(), "this model has no derivative by the position"),
    ):
        try:
            refused_call()
        except pwrfgs.InputError as error:
            assert words in str(error), error
        else:
            raise AssertionError(f"{words}: not refused")


def pose_tensors(count=None):
    """Position and orientation of a receiver, or of several, which want gradients."""
    turn = np.array([0.2, -0.3, 0.5, 0.8]) + (0.1 * np.arange(4) * np.arange(count or 1)[:, None] if count else 0)
    place = np.array([0.1, -0.2, 0.05]) + (0.1 * np.arange(count)[:, None] if count else 0)
    turn = turn / np.linalg.norm(turn, axis=-1, keepdims=True)
    return tuple(torch.tensor(part).to(REAL).requires_grad_() for part in (place, turn))


def batches_are_their_images_one_by_one():
    for waves in (False, True):
        given = tensors(3, waves)
        signals = torch.stack([given["signals"].detach() * k for k in (1.0, 2.0, 3.0)]).requires_grad_()
        poses = [POSE, pwrfgs.Pose((0.3, 0.0, 0.1)), pwrfgs.Receiver(position=(0.0, 0.1, -0.1))]
        means = (given["means"].detach() + torch.arange(3)[:, None, None] * 0.1).requires_grad_()
        alone = {**given, "signals": signals[1]}
        for batch, one in (
            (dict(signals=signals, pose=POSE), dict(alone, pose=POSE)),
            (dict(signals=signals, pose=poses), dict(alone, pose=poses[1])),
            (dict(signals=given["signals"], pose=poses), dict(given, pose=poses[1])),
            (dict(signals=signals, means=means, pose=POSE), dict(alone, means=means[1], pose=POSE)),
        ):
            images = pwrfgs.torch.rasterize(**{**given, **batch}, height=12, width=48)
            want = pwrfgs.torch.rasterize(**one, height=12, width=48)
            assert images.shape == (3, *want.shape) and torch.allclose(images[1], want, atol=1e-6), (waves, batch.keys())
            found = torch.autograd.grad(images[1].abs().sum(), [given["scales"], batch["signals"]])
            slopes = torch.autograd.grad(want.abs().sum(), [given["scales"], batch["signals"]])
            assert all(torch.allclose(a, b, rtol=1e-3, atol=1e-5) for a, b in zip(found, slopes)), batch.keys()
    for change, words in (
        (dict(signals=signals[:2], pose=poses), "different batches: signals [2"),
        (dict(pose=(torch.zeros(2), torch.zeros(4))), "position has shape [2], expected [3] or [B, 3]"),
        (dict(pose=(torch.zeros(3), torch.zeros(4))), "the quaternion is zero"),
        (dict(pose=(torch.zeros(3), torch.zeros(4).half())), "orientation: unsupported type"),
        (dict(pose=pose_tensors(), projector="WrfgsCompat"), "use Mercator()"),
    ):
        try:
            pwrfgs.torch.rasterize(**{**given, **change}, height=12, width=48)
        except pwrfgs.InputError as error:
            assert words in str(error), error
        else:
            raise AssertionError(f"{words}: not refused")


def receiver_is_found_by_its_gradient():
    """A step along the gradient of the pose brings the image closer."""
    given = {name: x.detach() for name, x in tensors(3).items()}
    truth = pwrfgs.torch.rasterize(**given, pose=POSE, height=12, width=48)
    position = torch.tensor([0.25, -0.1, 0.1]).to(REAL).requires_grad_()
    turn = torch.tensor([0.05, 0.05, 0.45, 0.88]).to(REAL).requires_grad_()
    optimizer, losses = torch.optim.Adam([position, turn], lr=0.01), []
    for _ in range(60):
        optimizer.zero_grad()
        loss = (pwrfgs.torch.rasterize(**given, pose=(position, turn), height=12, width=48) - truth).square().mean()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.1 * losses[0], losses
    assert np.abs(position.detach().numpy() - POSE.position).max() < 0.08


def positions_are_of_either_precision():
    """As a loader gives them, or converted to the type of a network."""
    octaves = pwrfgs.settings.Encoding.Octaves(1)
    network = pwrfgs.Factored(depth=1, width=8, position_encoding=octaves, tx_encoding=octaves)
    given = gaussians(4)
    given["signals"] = given["signals"] @ [1, 1j]
    model = pwrfgs.Model.from_arrays(**given, pose=POSE, height=12, width=48, deformation=network)
    data = pwrfgs.Dataset.from_arrays([[0.5, -0.25, 1.0], [1.25, 0.5, 0.75]], spectra=np.zeros((2, 12, 48)))
    (batch,) = torch.utils.data.DataLoader(data, batch_size=2)
    assert batch.tx.dtype == torch.float64
    columns = [x.detach() for x in tensors(3).values()]
    turn = torch.tensor([0.0, 0, 0, 1])
    for dtype in (torch.float32, torch.float64):
        tx = batch.tx.to(dtype)
        want = model.predict(batch.tx.numpy())
        assert np.array_equal(model.predict(tx), want) and np.array_equal(model.predict(tx.numpy()), want)
        assert np.array_equal(model.predict(tx[0], vjp=want[0])[0], want[0])
        assert np.array_equal(model.gaussians(tx[0]).means, model.gaussians(batch.tx[0].numpy()).means)
        assert np.array_equal(pwrfgs.Dataset.from_arrays(tx, spectra=batch.observation).tx, data.tx)
        free = tx.clone().requires_grad_()
        found = pwrfgs.torch.predict(model, free)
        found.sum().backward()
        assert found.dtype == REAL and free.grad.dtype == dtype and np.array_equal(found.detach().numpy(), want)
        place = tx[0].clone().requires_grad_()
        pwrfgs.torch.rasterize(*columns, (place, turn.to(dtype)), 12, 48).square().sum().backward()
        assert place.grad.dtype == dtype and place.grad.abs().sum() > 0
        pwrfgs.torch.rasterize(*columns, (batch.tx.to(dtype), torch.stack([turn, turn])), 12, 48)


def transforms_of_torch_func_are_those_of_autograd():
    if not hasattr(torch, "func"):  # PyTorch below 2.0
        return
    from torch.func import grad, jacrev, vmap

    octaves = pwrfgs.settings.Encoding.Octaves(1)
    network = pwrfgs.Factored(depth=1, width=8, position_encoding=octaves, tx_encoding=octaves)
    given = gaussians(4)
    given["signals"] = given["signals"] @ [1, 1j]
    model = pwrfgs.Model.from_arrays(**given, pose=POSE, height=4, width=6, deformation=network)
    tx = torch.tensor([[0.4, -0.2, 0.9], [1.2, 0.3, 0.7]], dtype=torch.float64)

    def predict(tx):
        return pwrfgs.torch.predict(model, tx)

    def misfit(tx):
        return predict(tx).square().sum()

    free = tx.clone().requires_grad_()
    (slope,) = torch.autograd.grad(misfit(free), free)
    assert torch.equal(grad(misfit)(tx), slope) and torch.allclose(vmap(grad(misfit))(tx), slope)
    assert torch.allclose(vmap(predict)(tx), predict(tx))
    (row,) = torch.autograd.grad(predict(free)[1, 2, 3], free)
    assert torch.allclose(jacrev(predict)(tx[1])[2, 3], row[1]) and vmap(jacrev(predict))(tx).shape == (2, 4, 6, 3)
    for waves in (False, True):
        columns = {name: x.detach() for name, x in tensors(3, waves).items()}
        signals = torch.stack([columns["signals"] * k for k in (1.0, 2.0, 3.0)])

        def draw(means, signals, position, columns=columns):
            pose = position, torch.tensor([0.0, 0, 0, 1])
            return pwrfgs.torch.rasterize(**{**columns, "means": means, "signals": signals}, pose=pose, height=12, width=48)

        def power(*given, draw=draw):
            return draw(*given).abs().square().sum()

        place = torch.zeros(3, dtype=REAL)
        images = vmap(draw, in_dims=(None, 0, None))(columns["means"], signals, place)
        assert torch.allclose(images, torch.stack([draw(columns["means"], one, place) for one in signals]))
        given = [x.clone().requires_grad_() for x in (columns["means"], signals[1], place)]
        slopes = torch.autograd.grad(power(*given), given)
        assert all(map(torch.equal, grad(power, argnums=(0, 1, 2))(*[x.detach() for x in given]), slopes))
        found = vmap(grad(power, argnums=(0, 1, 2)), in_dims=(None, 0, None))(columns["means"], signals, place)
        assert all(torch.allclose(one[1], slope) for one, slope in zip(found, slopes))
    try:
        grad(lambda tx: grad(misfit)(tx).sum())(tx)
    except RuntimeError as error:
        assert "no second derivative" in str(error), error
    else:
        raise AssertionError("a second derivative did not raise an error")


class Net(pwrfgs.torch.Deformation):
    """A small network in PyTorch."""

    def __init__(self, width=8, seed=0):
        self.width, self.seed = width, seed

    def module(self):
        return Pairs(self.width)


class Pairs(torch.nn.Module):
    def __init__(self, width):
        super().__init__()
        self.hidden, self.last = torch.nn.Linear(6, width), torch.nn.Linear(width, 2)

    def forward(self, means, tx):
        pairs = torch.cat([means.expand(len(tx), -1, -1), tx[:, None].expand(-1, len(means), -1)], dim=2)
        return self.last(torch.tanh(self.hidden(pairs)))


def networks_and_losses_of_torch_are_trained():
    def loss(predictions, truths):
        return (predictions - truths).square().mean()

    data = pwrfgs.Teacher(gaussians=5, samples=60, width=48, height=12)
    training = dict(steps=8, batch=4, densify_until=0, prune_until=0, validate_every=0)
    pipeline = pwrfgs.Pipeline(name="net", data=data, initializer=pwrfgs.Random(count=30, std=2.0), training=training)
    pipeline.deformation = Net(seed=3)
    data = pipeline.load_data()
    trainer = pwrfgs.Trainer(pipeline, data, loss=pwrfgs.torch.loss(loss))
    losses = [trainer.step()["loss"] for _ in range(8)]
    assert np.isfinite(losses).all() and min(losses[4:]) < losses[0]
    model = trainer.model()
    assert not np.allclose(*model.predict([[0.0, 0, 1], [1.0, 1, 1]]))
    own = Net(seed=3)
    weights, rng = own.weights(), np.random.default_rng(0)
    means, tx = rng.normal(size=(4, 3)), rng.normal(size=(2, 3))
    d = {"signals": rng.normal(size=(2, 4, 2))}
    slopes, d_means = own.vjp(weights, means, tx, d)
    step, change = 1e-2, rng.normal(size=means.shape)
    value = [(own.forward(weights, means + sign * step * change, tx)["signals"] * d["signals"]).sum() for sign in (1, -1)]
    assert np.isclose((value[0] - value[1]) / (2 * step), (d_means * change).sum(), rtol=1e-2)
    assert set(slopes) == set(weights) == {"hidden.weight", "hidden.bias", "last.weight", "last.bias"}


def loop_of_the_readme_ends_in_a_report():
    root = pathlib.Path(__file__).resolve().parents[2]
    example, readme = root / "python/examples/own_loop.py", root / "python/README.md"
    assert "[examples/own_loop.py](examples/own_loop.py)" in readme.read_text(encoding="utf-8")
    sys.path.insert(0, str(example.parent))
    import own_loop

    data = "Teacher(gaussians: 5, samples: 60, width: 48, height: 12)"
    text = f"Pipeline(name: \"own\", data: {data}, initializer: Random(count: 20), baselines: [MeanSpectrum()], metrics: [Ssim()])"
    read = pwrfgs.Pipeline
    own_loop.pwrfgs.Pipeline = lambda name: read(text)
    try:
        with tempfile.TemporaryDirectory() as folder:
            run = own_loop.main(steps=6, out=f"{folder}/own")
            assert run.finished and "ssim" in run.scores["model"] and run.model.n == 20
            assert not np.allclose(*run.model.predict([[0.0, 0, 1], [1.0, 1, 1]]))
    finally:
        own_loop.pwrfgs.Pipeline = read


def loader_gives_batches_by_workers():
    spectra = np.random.default_rng(1).random((12, 9, 36)).astype(np.float32)
    data = pwrfgs.Dataset.from_arrays(np.random.default_rng(0).normal(size=(12, 3)), spectra)
    for workers in (0, 2):
        batches = list(torch.utils.data.DataLoader(data, batch_size=5, num_workers=workers))
        assert [tuple(batch.observation.shape) for batch in batches] == [(5, 9, 36), (5, 9, 36), (2, 9, 36)]
        assert np.array_equal(torch.cat([batch.observation for batch in batches]).numpy(), spectra)
    poses = np.tile([0.0, 0, 1, 0, 0, 0, 1], (12, 1))
    moving = pwrfgs.Dataset.from_arrays(spectra=spectra, rx_pose=poses)
    assert [tuple(batch.rx_pose.shape) for batch in torch.utils.data.DataLoader(moving, batch_size=6)] == [(6, 7), (6, 7)]


def poses_have_central_differences():
    """With waves, whose images have no steps; `test_numbers.py` has blending."""
    for waves in (False, True):
        given = [x.detach() for x in tensors(3, waves).values()]

        def picture(position, turn, given=given):
            return pwrfgs.torch.rasterize(*given, (position, turn), 12, 48, rasterizer="ArrayResponse")

        assert torch.autograd.gradcheck(picture, pose_tensors(2), eps=1e-7, atol=1e-4, rtol=1e-3, nondet_tol=0)


def main() -> None:
    complex_signals_are_those_of_numpy()
    gradients_have_the_types_of_their_tensors()
    what_cannot_be_computed_is_refused()
    batches_are_their_images_one_by_one()
    receiver_is_found_by_its_gradient()
    networks_and_losses_of_torch_are_trained()
    predictions_are_differentiable()
    positions_are_of_either_precision()
    transforms_of_torch_func_are_those_of_autograd()
    loader_gives_batches_by_workers()
    loop_of_the_readme_ends_in_a_report()
    if REAL == torch.float64:
        derivatives_are_central_differences()
        poses_have_central_differences()


if __name__ == "__main__":
    main()
    print(f"gradcheck of {REAL} passed, torch {torch.__version__}")

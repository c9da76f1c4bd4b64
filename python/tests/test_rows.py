"""Single links, subsets, iteration, loaders of PyTorch and pickles of data sets."""

from __future__ import annotations

import multiprocessing
import pickle

import numpy as np
import pytest

import pwrfgs

TX = np.random.default_rng(0).uniform((0, 0, 1), (4, 3, 1.5), (12, 3))


@pytest.fixture(scope="module")
def spectra():
    values = np.random.default_rng(1).random((12, 9, 36)).astype(np.float32)
    return pwrfgs.Dataset.from_arrays(TX, values, points=[[0, 0, 0], [4, 3, 3]], title="mine", simulated=True)


@pytest.fixture(scope="module")
def moving():
    values = np.random.default_rng(4).random((12, 9, 36)).astype(np.float32)
    turn = np.linspace(0, 3, 12)
    turns = np.stack([0 * turn, 0 * turn, np.sin(turn), np.cos(turn)], axis=1)
    return pwrfgs.Dataset.from_arrays(
        spectra=values, rx_pose=np.concatenate([TX, turns], axis=1), transmitter=(2, 1, 2.9), simulated=True
    )


@pytest.fixture(scope="module")
def carriers():
    values = np.random.default_rng(5).random((12, 9, 36)).astype(np.float32)
    tx = np.tile(TX[:6], (2, 1))
    return pwrfgs.Dataset.from_arrays(tx, values, carriers_hz=np.repeat([2.4e9, 2.5e9], 6))


@pytest.fixture(scope="module")
def powers():
    rssi = -40 - 10 * np.random.default_rng(2).random((12, 2))
    rssi[3, 1] = np.nan
    return pwrfgs.Dataset.from_arrays(TX, rssi=rssi, receivers=[[0, 0, 2.5], [4, 3, 2.5]])


@pytest.fixture(scope="module")
def channels():
    csi = np.random.default_rng(3).normal(size=(12, 2, 3)) + 1j
    receiver = pwrfgs.Receiver(position=(4, 3, 2.9), antennas=[(0, 0, 0), (0.5, 0, 0)])
    return pwrfgs.Dataset.from_arrays(TX, csi=csi, frequencies_hz=[1e8, 2e8, 3e8], receivers=receiver)


def same(one, other):
    assert repr(one) == repr(other) and len(one) == len(other)
    for name in ("positions", "rx_pose", "transmitter", "ids", "receiver", "points", "spectra", "rssi", "csi", "frequencies_hz"):
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None and b is None) or np.array_equal(a, b), name
    assert one.receivers == other.receivers
    assert all(np.array_equal(a, b) for a, b in zip(one.split("random", test=0.3), other.split("random", test=0.3)))


@pytest.mark.parametrize("kind", ["spectra", "moving", "carriers", "powers", "channels"])
def test_rows_subsets_and_pickles_hold_the_same_observations(kind, request):
    data = request.getfixturevalue(kind)
    everything = data.observations(np.arange(len(data)))
    rows = list(data)
    assert len(rows) == len(data) and all(
        isinstance(row, pwrfgs.Sample if data.rx_pose is None else pwrfgs.ReceiverSample) for row in rows
    )
    for i, row in enumerate(rows):
        assert np.array_equal(row[0][:3], data.positions[i]) and np.array_equal(row.observation, everything[i])
        assert (row.id, row.receiver) == (data.ids[i], data.receiver[i])
    assert np.array_equal(data[-1].observation, everything[-1])
    part = data.subset([7, 2, 5])
    assert np.array_equal(part.observations([0, 1, 2]), everything[[2, 5, 7]]) and np.array_equal(part.positions, data.positions[[2, 5, 7]])
    assert part.receivers == data.receivers and np.array_equal(part.points, data.points)
    same(data[np.arange(len(data)) % 2 == 0], data[::2])
    same(pickle.loads(pickle.dumps(data)), data)
    same(pickle.loads(pickle.dumps(part)), part)


def test_pickled_part_keeps_the_bounds_of_map_coordinates(moving):
    poses = moving.rx_pose + np.array([5e5, 54e5, 0, 0, 0, 0, 0])
    whole = pwrfgs.Dataset.from_arrays(spectra=moving.spectra, rx_pose=poses)
    part = whole[np.argsort(poses[:, 0])[:4]]  # its origin is near its first pose
    bounds = pickle.loads(pickle.dumps(part)).__reduce__()[1][0]["bounds"]
    assert np.allclose(bounds, [poses[:, :3].min(axis=0), poses[:, :3].max(axis=0)], rtol=0, atol=1e-3)


def test_carriers_are_receivers(carriers, tmp_path):
    assert [receiver.name for receiver in carriers.receivers] == ["2400MHz", "2500MHz"]
    assert [receiver.carrier_hz for receiver in carriers.receivers] == [2.4e9, 2.5e9]
    assert np.array_equal(carriers.receiver, np.tile([0, 1], 6))
    carriers.save(tmp_path / "carriers")
    again = pwrfgs.Dataset.load(tmp_path / "carriers")
    assert again.receivers == carriers.receivers and np.array_equal(again.spectra, carriers.spectra)
    with pytest.raises(pwrfgs.InputError, match="3 carriers for 12 links; give as many of each"):
        pwrfgs.Dataset.from_arrays(TX, carriers.spectra, carriers_hz=[1e9] * 3)


def test_a_model_of_a_moving_receiver_predicts_at_poses(moving, pipeline, tmp_path):
    moving.save(tmp_path / "walk")
    again = pwrfgs.Dataset.load(tmp_path / "walk")
    assert all(np.array_equal(getattr(again, name), getattr(moving, name)) for name in ("rx_pose", "transmitter", "spectra"))
    trainer = pwrfgs.Trainer(pipeline, moving)
    trainer.step()
    model = trainer.model()
    poses = moving.rx_pose
    there = model.predict(rx_pose=poses)
    assert there.shape == (12, 9, 36) and np.array_equal(model.predict(rx_pose=poses[3]), there[3])
    level = np.concatenate([moving.positions, np.tile([0, 0, 0, 1.0], (12, 1))], axis=1)
    assert not np.array_equal(model.predict(rx_pose=level), there)
    _, slopes = model.predict(rx_pose=poses, vjp=np.random.default_rng(0).normal(size=there.shape))
    assert slopes.shape == (12, 7)
    lengthwise = (slopes[:, 3:] * poses[:, 3:]).sum(axis=1)
    assert np.abs(slopes[:, 3:]).max() > 0 and np.abs(lengthwise).max() < 1e-6 * np.abs(slopes).max()
    assert model.moving == "receiver" and "receiver at" in model._repr_html_() and "receiver at" in moving._repr_html_()
    model.save(tmp_path / "m.safetensors")
    assert np.array_equal(pwrfgs.Model.load(tmp_path / "m.safetensors").predict(rx_pose=poses), there)
    with pytest.raises(pwrfgs.InputError, match="the receiver of these data moves; use rx_pose"):
        moving.tx
    with pytest.raises(pwrfgs.InputError, match=r"the receiver of this model moves; pass rx_pose=\[B, 7\]"):
        model.predict(moving.positions)
    with pytest.raises(pwrfgs.InputError, match="rx_pose"):
        pwrfgs.Dataset.from_arrays(spectra=moving.spectra, rx_pose=np.zeros((12, 3)))
    with pytest.raises(pwrfgs.InputError, match=r"rx_pose\[0\]: the quaternion is zero"):
        pwrfgs.Dataset.from_arrays(spectra=moving.spectra, rx_pose=np.zeros((12, 7)))
    with pytest.raises(pwrfgs.InputError, match="give tx: positions"):
        pwrfgs.Dataset.from_arrays(TX, moving.spectra, rx_pose=poses)


def test_invalid_indices_are_reported(spectra):
    with pytest.raises(IndexError, match="invalid link index 12"):
        spectra[12]
    with pytest.raises(IndexError):
        spectra[-13]
    for links, said in [([], "at least one"), ([1, 1], "link 1 is listed twice"), ([99], "invalid link index 99"), ("x", "links: give indices")]:
        with pytest.raises(pwrfgs.InputError, match=said):
            spectra.subset(links)


def test_source_of_data_is_pickled(spectra, tmp_path):
    spectra.save(tmp_path / "data")
    data = pwrfgs.Dataset.load(tmp_path / "data")
    again = pickle.loads(pickle.dumps(data))
    same(again, data)
    assert pwrfgs.Pipeline(name="a", data=again, initializer=pwrfgs.Random()).data.root == str(tmp_path / "data")
    # Arrays above 512 MB stay in their file, and are pickled so.
    same(pwrfgs.Dataset._restore({"source": data._source}), data)


def test_a_model_is_trained_on_a_subset(dataset, pipeline):
    trainer = pwrfgs.Trainer(pipeline, dataset.subset(np.arange(50)))
    trainer.step()
    assert trainer.model().predict(dataset[60].tx).shape == dataset[60].observation.shape


def _sum(data, links):
    return float(sum(data[i].observation.sum() for i in links))


def _send(data, queue):
    queue.put(_sum(data, range(len(data))))


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_other_processes_read_links(spectra, method):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"there is no {method} here")
    context = multiprocessing.get_context(method)
    queue = context.Queue()
    process = context.Process(target=_send, args=(spectra, queue))
    process.start()
    assert queue.get(timeout=60) == pytest.approx(_sum(spectra, range(12)))
    process.join(60)


def test_loader_of_torch_gives_batches(spectra):
    data = pytest.importorskip("torch.utils.data")
    for workers in (0, 2):
        batches = list(data.DataLoader(spectra, batch_size=5, num_workers=workers))
        assert [tuple(batch.observation.shape) for batch in batches] == [(5, 9, 36), (5, 9, 36), (2, 9, 36)]
        assert np.array_equal(np.concatenate([batch.observation.numpy() for batch in batches]), spectra.spectra)

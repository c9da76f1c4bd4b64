"""Data in and out."""

from __future__ import annotations

import numpy as np
import pytest

import pwrfgs

ONE = [(0.0, 0.0, 2.0)]
TX = np.random.default_rng(0).uniform(0, 4, size=(30, 3))


def spectra(n=30):
    return np.random.default_rng(1).uniform(size=(n, 12, 36)).astype(np.float32)


def test_huge_numbers_have_an_exponent_in_messages():
    with pytest.raises(pwrfgs.InputError, match=r"rssi\[0, 0\] is 1\.0\d*e35, no power in dBm"):
        pwrfgs.Dataset.from_arrays([[1, 2, 3]], rssi=[[1e35]], receivers=[[0, 0, 0]])


def test_spectra_come_and_go(tmp_path):
    given = spectra()
    receiver = pwrfgs.Receiver("gate", (1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))
    data = pwrfgs.Dataset.from_arrays(TX, given, receivers=[receiver], points=[[1, 2, 3.0]], title="mine", simulated=True)
    assert len(data) == 30 and data.kind == "spectrum" and data.simulated and data.title == "mine (simulated)"
    assert np.allclose(data.spectra, given) and np.array_equal(data.tx, TX) and data.rssi is None and data.csi is None
    assert data.receivers == [receiver] and np.array_equal(data.points, [[1, 2, 3]])
    assert np.array_equal(data.observations([3, 1]), data.spectra[[3, 1]])
    assert "simulated" in repr(data)
    data.save(tmp_path / "mine")
    again = pwrfgs.Dataset.load(tmp_path / "mine")
    assert np.array_equal(again.spectra, data.spectra) and np.array_equal(again.tx, data.tx) and again.simulated
    with pytest.raises(pwrfgs.Error):
        data.save(tmp_path / "mine")


def test_observations_are_read_only_views_of_one_array():
    grey = np.zeros((30, 12, 36), np.uint8)
    grey[:, 3, 5] = np.arange(30)
    data = pwrfgs.Dataset.from_arrays(TX, grey)
    assert np.shares_memory(data.spectra, data.spectra) and data.spectra.dtype.itemsize == pwrfgs._pwrfgs.real_bytes
    with pytest.raises(ValueError, match="read-only"):
        data.spectra[0] = 1
    powers = pwrfgs.Dataset.from_arrays(TX, rssi=np.linspace(-60, -50, 30), receivers=[[0, 0, 2]])
    assert np.shares_memory(powers.rssi, powers.rssi) and powers.spectra is None and not powers.rssi.flags.writeable


def test_bytes_stay_bytes():
    grey = np.random.default_rng(2).integers(0, 256, size=(30, 12, 36), dtype=np.uint8)
    assert np.allclose(pwrfgs.Dataset.from_arrays(TX, grey).spectra, grey / 255, atol=1e-7)


def test_powers_and_channels(tmp_path):
    rssi = np.random.default_rng(3).uniform(-90, -40, size=(30, 2))
    rssi[0, 1] = np.nan
    data = pwrfgs.Dataset.from_arrays(TX, rssi=rssi, receivers=[[0, 0, 2.0], [4, 4, 2.0]])
    assert len(data) == 59 and data.kind == "power" and data.rssi.shape == (59,)
    assert np.allclose(data.rssi, rssi[~np.isnan(rssi)], atol=1e-4) and data.receiver[:3].tolist() == [0, 0, 1]
    data.save(tmp_path / "rssi")
    assert np.allclose(pwrfgs.Dataset.load(tmp_path / "rssi").rssi, data.rssi, atol=1e-4)
    csi = np.random.default_rng(4).normal(size=(30, 2, 5)) + 1j
    antennas = [(0.0, 0.0, 0.0), (0.06, 0.0, 0.0)]
    hz = 2.4e9 + 3e5 * np.arange(5)
    data = pwrfgs.Dataset.from_arrays(TX, csi=csi, receivers=[pwrfgs.Receiver(antennas=antennas)], frequencies_hz=list(hz))
    assert data.csi.shape == (30, 2, 5) and np.iscomplexobj(data.csi) and np.allclose(data.csi, csi, atol=1e-6)
    data.save(tmp_path / "csi")
    assert np.allclose(pwrfgs.Dataset.load(tmp_path / "csi").csi, data.csi)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (dict(), "give one of spectra, rssi and csi"),
        (dict(spectra=spectra(), rssi=np.zeros(30)), "give one of"),
        (dict(spectra=spectra(29)), "spectra has shape [29, 12, 36], expected [30, any, any]"),
        (dict(spectra=2 * spectra()), "spectra are linear, from 0 to 1"),
        (dict(spectra=np.full((30, 12, 36), np.nan, np.float32)), "is NaN"),
        (dict(spectra=spectra().transpose(0, 2, 1)), "s.transpose(0, 2, 1)"),
        (dict(spectra=np.zeros((30, 18, 36), np.uint8)), "such as elevation_deg=(-90, 90) for a full sphere"),
        (dict(rssi=np.full(30, -60.0)), "rssi has shape [30], but receivers is missing; pass receivers=[..] with 1 position [x, y, z]"),
        (dict(rssi=np.zeros((30, 3))), "pass receivers=[..] with 3 positions"),
        (dict(rssi=np.where(np.arange(30) == 3, np.nan, -60.0), receivers=ONE), "rssi[3] is NaN throughout"),
        (dict(rssi=np.tile([-60.0, np.nan], (30, 1)), receivers=[[0, 0, 2], [4, 4, 2]]), "rssi[:, 1] is NaN throughout"),
        (dict(rssi=np.full(30, -60.0), receivers=ONE, elevation_deg=(0, 90)), "only valid for spectra"),
        (dict(rssi=np.full(30, -60.0), receivers=ONE, frequencies_hz=[1e9]), "only valid for csi"),
        (dict(rssi=np.full(30, 1e6), receivers=ONE), "no power in dBm"),
        (dict(rssi=np.full(30, -60.0), receivers=[pwrfgs.Receiver('a"b')]), "1 to 100 characters"),
        (dict(rssi=np.zeros((30, 3)), receivers=ONE), "rssi has shape [30, 3], expected [30, 1]"),
        (dict(csi=np.zeros((30, 1, 4), complex)), "needs frequencies_hz"),
        (dict(spectra=spectra(), receivers=[[0, 0]]), "a receiver has shape [2]"),
        (dict(spectra=spectra(), receivers=[pwrfgs.Receiver(orientation=(0, 0, 0, 2.0))]), "has length 2"),
        (dict(spectra=spectra(), points=[[0, 0, np.inf]]), "points[0]"),
    ],
)
def test_what_cannot_be_is_refused(given, said):
    with pytest.raises(pwrfgs.InputError) as told:
        pwrfgs.Dataset.from_arrays(TX, **given)
    assert said in str(told.value)


def test_splits(dataset):
    parts = dataset.split("voxel", size_m=0.5)
    every = np.concatenate(parts)
    assert sorted(every) == list(range(len(dataset))) and (np.diff(parts.train) > 0).all()
    assert [a.tolist() for a in dataset.split(pwrfgs.TimeBlock())] == [a.tolist() for a in dataset.split("time_block")]
    assert not np.array_equal(dataset.split("Random", seed=1).test, dataset.split("Random", seed=2).test)
    with pytest.raises(pwrfgs.InputError, match="did you mean `Voxel`"):
        dataset.split("vxel")
    with pytest.raises(pwrfgs.InputError, match="size_m"):
        dataset.split("voxel", size=1.0)
    for wrong, settings in [(None, dict(test_size=0.2)), ("Random(test: 0.2)", dict(test=0.3)), (pwrfgs.Voxel(), dict(size_m=0.2))]:
        with pytest.raises(pwrfgs.InputError, match="settings"):
            dataset.split(wrong, **settings)
    with pytest.raises(pwrfgs.InputError, match="invalid link index 900"):
        dataset.observations([900])


def test_a_folder_without_data_is_told(tmp_path):
    with pytest.raises(pwrfgs.InputError, match="no data of a known layout"):
        pwrfgs.Dataset.load(tmp_path)


@pytest.mark.parametrize("elevation, size", [((10, 80), (8, 32)), ((90, 0), (12, 36)), ((-90, 90), (16, 32)), ((0, 45), (8, 20))])
def test_angles_and_points_are_saved(tmp_path, elevation, size):
    given = np.random.default_rng(1).uniform(size=(30, *size)).astype(np.float32)
    data = pwrfgs.Dataset.from_arrays(TX, given, elevation_deg=list(elevation), points=[[1, 2, 3.0]])
    data.save(tmp_path / "d")
    again = pwrfgs.Dataset.load(tmp_path / "d")
    assert np.array_equal(again.points, [[1, 2, 3]])
    for one, other in zip(data.angles_deg, again.angles_deg):
        assert np.array_equal(one, other)


def test_links_are_places_or_a_mask():
    data = pwrfgs.Dataset.from_arrays(TX, spectra())
    mask = np.arange(30) >= 28
    assert np.array_equal(data.observations(mask), data.spectra[28:])
    assert np.allclose(pwrfgs.baselines.mean(data, TX[:1], mask)[0], data.spectra[28:].mean(0), atol=1e-5)
    for wrong in (mask[:5], [4.9], [-1], [30]):
        with pytest.raises(pwrfgs.InputError, match="links"):
            data.observations(wrong)
    assert data.observations([]).shape == (0, 12, 36)


def test_settings_of_a_simulation_that_would_do_nothing_are_refused(tmp_path):
    for settings, said in [(dict(snr_db=3.0), "snr_db is only for channels"), (dict(noise_db=3.0), "noise_db is only for powers"), (dict(layout="rsssi"), "did you mean `rssi`")]:
        with pytest.raises(pwrfgs.InputError, match=said):
            pwrfgs.simulate(tmp_path / "none.ron", tmp_path / "s", progress=False, **settings)
    with pytest.raises(pwrfgs.InputError):
        pwrfgs.Dataset.from_arrays(TX, spectra()).save("")


def test_antennas_are_where_the_receiver_says():
    tx, hz = np.zeros((3, 3)), [1e9, 1.1e9]
    csi = np.ones((3, 2, 2), np.complex64)
    with pytest.raises(pwrfgs.InputError, match="channels have 2 antennas, and receiver `receiver` has 1"):
        pwrfgs.Dataset.from_arrays(tx, csi=csi, frequencies_hz=hz)
    with pytest.raises(pwrfgs.InputError, match=r"expected positions \[A, 3\]"):
        pwrfgs.Receiver(antennas=[(0, 0)])
    receiver = pwrfgs.Receiver(position=(0, 0, 2), antennas=[(0, 0, 0), (0.1, 0, 0)])
    data = pwrfgs.Dataset.from_arrays(tx, csi=csi, frequencies_hz=hz, receivers=[receiver])
    assert data.receivers[0].antennas == receiver.antennas


def test_what_is_accepted_is_read_back_equal(tmp_path):
    rng = np.random.default_rng(5)
    turned = (0.0, 0.0, 0.6, 0.8)
    rssi = np.where(rng.uniform(size=(30, 2)) < 0.2, np.nan, rng.uniform(-90, -40, (30, 2)))
    rssi[:, 0] = -50.0
    for k, given in enumerate([
        dict(spectra=spectra(), receivers=[pwrfgs.Receiver("gate, é", (1, 2, 3), turned)], elevation_deg=(90, 0), simulated=True),
        dict(rssi=rssi, receivers=[pwrfgs.Receiver("a, b", (0, 0, 2), turned), pwrfgs.Receiver("[c", (4, 4, 2))]),
        dict(csi=rng.normal(size=(30, 1, 3)) + 1j, frequencies_hz=[2.4e9, 2.1e9, 2.2e9], receivers=[pwrfgs.Receiver("x: y", (1, 2, 3), turned)]),
    ]):  # fmt: skip
        data = pwrfgs.Dataset.from_arrays(TX, **given)
        data.save(tmp_path / str(k))
        again = pwrfgs.Dataset.load(tmp_path / str(k))
        assert again.receivers == data.receivers and np.array_equal(again.ids, data.ids) and again.simulated == data.simulated
        for name in ("tx", "receiver", "spectra", "rssi", "csi", "frequencies_hz", "angles_deg"):
            one, other = getattr(data, name), getattr(again, name)
            assert (one is None) == (other is None) and (one is None or all(map(np.array_equal, one, other))), name


def test_wrong_units_are_warned_of(tmp_path):
    for data, words in [
        (dict(rssi=10 ** np.linspace(-9, -4, 30), receivers=ONE), "10 \\* log10"),
        (dict(rssi=np.full(30, 45.0) - 90 * (np.arange(30) < 3), receivers=ONE), "median 45, are not in dBm"),
        (dict(spectra=np.tile(spectra(1), (30, 1, 1))), "all 30 spectra are equal"),
    ]:
        with pytest.warns(UserWarning, match=words):
            made = pwrfgs.Dataset.from_arrays(TX, **data)
    made.save(tmp_path / "equal")
    with pytest.warns(UserWarning, match="all 30 spectra are equal") as caught:
        pwrfgs.Dataset.load(tmp_path / "equal")
    assert {warning.filename for warning in caught} == {__file__}
    with pytest.warns(UserWarning, match="convert them to metres"):
        pwrfgs.Dataset.from_arrays(100 * TX, rssi=np.linspace(-60, -50, 30), receivers=ONE)
    with pytest.raises(pwrfgs.InputError, match="no such folder"):
        pwrfgs.Dataset.load(tmp_path / "nowhere")


def test_a_law_of_distance_a_receiver():
    rng = np.random.default_rng(0)
    tx, receivers = rng.uniform(0, 10, (60, 3)), np.array([[0, 0, 3], [10, 10, 3.0]])
    distance = np.linalg.norm(tx[:, None] - receivers, axis=2)
    rssi = [-40, -60] - np.array([20, 35]) * np.log10(distance)
    data = pwrfgs.Dataset.from_arrays(tx, rssi=rssi, receivers=receivers)
    for receiver, name in enumerate(["r0", "r1"]):
        found = pwrfgs.baselines.log_distance(data, tx[:5], receiver=name)
        assert np.allclose(found, rssi[:5, receiver], atol=1e-3)
        assert not np.allclose(pwrfgs.baselines.log_distance(data, tx[:5], receiver=receiver, per_receiver=False), found, atol=0.1)
    with pytest.raises(pwrfgs.InputError, match=r"unknown receiver 'r2' \(expected one of r0, r1\)"):
        pwrfgs.baselines.knn(data, tx, receiver="r2")
    with pytest.raises(pwrfgs.InputError, match="one of its sets"):
        pwrfgs.baselines.knn(data, tx, data.split("random"))

"""Spectra from channels, and data sets from Sionna RT and DeepMIMO. The packages themselves are optional."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import re
import sys
import tracemalloc
import types
import warnings
import zipfile

import numpy as np
import pytest
from conftest import ROOT

import pwrfgs
from pwrfgs import convert

C = 299_792_458.0
# Plane waves at the antennas, and few paths, so that a user of DeepMIMO keeps all of them.
SCENE = """(
    name: "small", carrier_hz: 2.4e9,
    room: (
        outline: Box(low: (0, 0, 0), high: (8, 6, 3)), walls: (material: "concrete", thickness_m: 0.1),
        floor: (material: "concrete", thickness_m: 0.25), ceiling: (material: "ceiling_board", thickness_m: 0.02),
    ),
    receiver: (
        position: (4, 3, 2.9), orientation: Facing(direction: (0.4, 0.2, -1)),
        array: (rows: 4, columns: 3, spacing_wavelengths: 0.45, wavefront: Plane),
    ),
    subcarriers: (count: 3, bandwidth_hz: 60e6),
    transmitter: (positions: Uniform(low: (1, 1, 1.0), high: (7, 5, 1.4))),
    propagation: (order: 1, room_order: 1),
)"""


def grid(rows, columns, spacing):
    """Antennas [A, 3] in the x-y plane, x fastest, centred."""
    y, x = (spacing * (np.arange(count) - (count - 1) / 2) for count in (rows, columns))
    return [(a, b, 0.0) for b in y for a in x]


def rotation(quaternion):
    """Matrix of a quaternion x, y, z, w."""
    x, y, z, w = quaternion
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def pixel(receiver, place):
    """Row and column of the direction to a place, to a fraction."""
    x, y, z = rotation(receiver.orientation).T @ np.subtract(place, receiver.position)
    return np.degrees(np.arctan2(z, np.hypot(x, y))), np.degrees(np.arctan2(y, x)) % 360


def assert_peaks_at_sources(data):
    for tx, image in zip(data.tx, data.spectra):
        row, column = np.unravel_index(image.argmax(), image.shape)
        wanted = pixel(data.receivers[0], tx)
        assert abs(row - wanted[0]) < 2 and abs((column - wanted[1] + 180) % 360 - 180) < 2 / np.cos(np.radians(row)), tx


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """Folder with channels and paths of the scene."""
    folder = tmp_path_factory.mktemp("simulated")
    (folder / "small.ron").write_text(SCENE)
    pwrfgs.simulate(folder / "small.ron", folder / "channels", layout="channels", samples=12, paths=True, progress=False)
    return folder


def test_spectrum_equals_that_of_the_simulator(simulated, tmp_path):
    channels = pwrfgs.Dataset.load(simulated / "channels")
    spectra = pwrfgs.simulate(simulated / "small.ron", tmp_path / "spectra", samples=12, progress=False)
    assert np.array_equal(channels.tx, spectra.tx)
    at_carrier, hz = channels.csi[:, :, 1], channels.frequencies_hz[1]
    found = pwrfgs.spectrum(at_carrier, channels.receivers[0], hz)
    assert hz == 2.4e9 and found.dtype == np.float32 and found.shape == spectra.spectra.shape
    grey, wanted = (255 * found).astype(int), np.round(255 * spectra.spectra).astype(int)
    assert np.abs(grey - wanted).max() <= 1 and (grey == wanted).mean() > 0.999
    mirrored = pwrfgs.spectrum(at_carrier.conj(), channels.receivers[0], hz)
    assert np.abs(mirrored - spectra.spectra).mean() > 0.05


def test_plane_wave_peaks_at_its_direction_in_the_receiver_frame():
    hz, row, column = 3e9, 40, 110
    receiver = pwrfgs.Receiver(orientation=(0.1, -0.5, 0.1, np.sqrt(0.73)), antennas=grid(6, 5, 0.048))
    up, around, world = np.radians(row), np.radians(column), rotation(receiver.orientation)
    places = np.array(receiver.antennas) @ world.T
    direction = world @ [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)]  # towards the source
    assert np.allclose(pixel(receiver, direction), (row, column))
    h = np.exp(-2j * np.pi * hz / C * (50.0 - places @ direction))  # path of length 50 m to the origin
    image = pwrfgs.spectrum(h, receiver, hz)
    assert image.min() == 0 and image.max() == 1
    assert np.unravel_index(image.argmax(), image.shape) == (row, column)
    below = pwrfgs.spectrum(h, receiver.antennas, hz, shape=(45, 90), elevation_deg=(-90, 0))
    assert abs(-90 + 2 * np.unravel_index(below.argmax(), below.shape)[0] + row) <= 2  # a planar array cannot see its side


def test_axes_are_kept_and_powers_of_subcarriers_are_averaged(monkeypatch):
    rng, antennas = np.random.default_rng(0), grid(3, 2, 0.06)
    h = rng.normal(size=(2, 3, 6, 2)) + 1j * rng.normal(size=(2, 3, 6, 2))
    found = pwrfgs.spectrum(h, antennas, [2.3e9, 2.5e9], shape=(9, 36))
    assert found.shape == (2, 3, 9, 36)
    up, around = np.meshgrid(np.radians(10.0 * np.arange(9)), np.radians(10.0 * np.arange(36)), indexing="ij")
    u = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1)
    power = sum(
        abs(np.exp(-2j * np.pi * hz / C * (u @ np.transpose(antennas))) @ h[1, 2, :, i]) ** 2 for i, hz in enumerate((2.3e9, 2.5e9))
    )
    amplitude = np.sqrt(power)
    assert np.allclose(found[1, 2], (amplitude - amplitude.min()) / np.ptp(amplitude), atol=1e-6)
    assert np.array_equal(pwrfgs.spectrum(h[..., 0], antennas, 2.3e9), pwrfgs.spectrum(h[..., :1], antennas, [2.3e9]))
    monkeypatch.setattr("pwrfgs._spectrum._BLOCK", 100)
    assert np.allclose(pwrfgs.spectrum(h, antennas, [2.3e9, 2.5e9], shape=(9, 36)), found, atol=1e-6)


def test_spectrum_is_black_without_signal_or_contrast():
    assert not pwrfgs.spectrum(np.zeros(4, complex), grid(2, 2, 0.05), 3e9).any()
    assert not pwrfgs.spectrum(np.array([2 + 1j]), [(0.1, 0.2, 0.0)], 3e9).any()


@pytest.mark.parametrize(
    ("csi", "antennas", "hz", "said"),
    [
        (np.ones(4), grid(2, 2, 0.05), 3e9, "csi has the type float64, expected complex"),
        (np.ones((7, 4), complex), grid(2, 3, 0.05), 3e9, "csi has shape [7, 4], expected [.., A] = [.., 6]: there are 6 antennas"),
        (np.ones((7, 4), complex), grid(2, 2, 0.05), [3e9], "expected [.., A, F] = [.., 4, 1]"),
        (np.full((2, 4), np.nan + 0j), grid(2, 2, 0.05), 3e9, "csi[0, 0] is not finite"),
        (np.ones(4, complex), [0, 0, 0], 3e9, "antennas has shape [3], expected finite positions [A, 3]"),
        (np.ones(4, complex), grid(2, 2, 0.05), 0.0, "frequency_hz must be a positive frequency"),
    ],
)
def test_spectrum_rejects_wrong_arrays(csi, antennas, hz, said):
    with pytest.raises(pwrfgs.InputError) as told:
        pwrfgs.spectrum(csi, antennas, hz)
    assert said in str(told.value)


def turned(angles):
    """Matrix of rotations around z, y and x, as in Sionna RT."""
    a, b, c = angles
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(c), -np.sin(c)], [0, np.sin(c), np.cos(c)]])
    return about_z @ about_y @ about_x


class Array:
    """Stand-in for PlanarArray: in the y-z plane, column by column from the top left."""

    def positions(self, wavelength):
        return 0.45 * wavelength[0] * np.array([(0.0, y, -z) for y in (-1.5, -0.5, 0.5, 1.5) for z in (-1, 0, 1)]).T


class Sionna:
    """Stand-in for scene and paths of Sionna RT in free space; the last transmitter has no path."""

    frequency, wavelength, rx_array = np.array([3.5e9], np.float32), np.array([C / 3.5e9]), Array()

    def __init__(self):
        places = {"hall": ((-1, -1, 1.7), (0.3, -0.4, 0.2)), "door": ((2, 2, 2.0), (0.0, 0.0, 0.0))}
        self.receivers = {
            name: types.SimpleNamespace(position=np.array(place)[:, None], orientation=np.array(angles)[:, None])
            for name, (place, angles) in places.items()
        }
        self.sources = np.array([(7, 2, 1.5), (5, -3, 1.0), (6, 0.3, 3.0), (0, 0, 0)]).T

    def cfr(self, *, frequencies, normalize_delays, out_type):
        assert not normalize_delays and out_type == "numpy"
        h = np.zeros((2, 12, 4, 1, 1, len(frequencies)), np.complex64)
        for r, device in enumerate(self.receivers.values()):
            antennas = self.rx_array.positions(self.wavelength).T @ turned(device.orientation[:, 0]).T + device.position[:, 0]
            d = np.linalg.norm(antennas[:, None] - self.sources.T[:3], axis=2)[..., None]
            h[r, :, :3, 0, 0] = np.exp(-2j * np.pi * (3.5e9 + frequencies) * d / C) / d
        return h


def test_sionna_spectra_peak_at_the_line_of_sight():
    scene = Sionna()
    with pytest.warns(UserWarning, match="1 of 4 transmitters have no path and are left out"):
        data = convert.from_sionna(scene, [0.0, 1e6], scene, receiver="hall")
    assert data.spectra.shape == (3, 90, 360) and data.simulated and data.receivers[0].name == "hall"
    assert np.array_equal(data.tx, scene.sources.T[:3])
    assert_peaks_at_sources(data)


@pytest.mark.filterwarnings("ignore:1 of 4 transmitters")
def test_sionna_channels_fit_the_antennas_and_powers_the_receivers():
    scene = Sionna()
    data = convert.from_sionna(scene, [-1e6, 1e6], scene, receiver="hall", observe="channel")
    receiver = data.receivers[0]
    antennas = np.array(receiver.antennas) @ rotation(receiver.orientation).T + receiver.position
    d = np.linalg.norm(data.tx[:, None] - antennas, axis=2)[..., None]
    assert data.frequencies_hz.tolist() == [3.499e9, 3.501e9]
    assert np.allclose(data.csi, np.exp(-2j * np.pi * data.frequencies_hz * d / C) / d, atol=1e-4)
    powers = convert.from_sionna(scene, 0.0, scene, observe="power", power_dbm=10.0)
    assert [r.name for r in powers.receivers] == ["hall", "door"] and len(powers) == 6
    distance = [np.linalg.norm(link.tx - powers.receivers[link.receiver].position) for link in powers]
    assert np.allclose(powers.rssi, 10 - 20 * np.log10(distance), atol=0.1)


@pytest.mark.filterwarnings("ignore:1 of 4 transmitters")
def test_sionna_mistakes_are_reported():
    scene = Sionna()
    for settings, said in [
        (dict(frequencies=[3.5e9]), "relative to the carrier of 3.5e\\+09 Hz"),
        (dict(receiver="hal"), "unknown receiver 'hal' \\(expected one of hall, door\\)"),
        (dict(), "there are 2 receivers; pass receiver=.., one of hall, door"),
        (dict(receiver="hall", observe="spectra"), "observe is 'spectra'"),
    ]:
        with pytest.raises(pwrfgs.InputError, match=said):
            convert.from_sionna(scene, settings.pop("frequencies", [0.0]), scene, **settings)
    scene.receivers.popitem()
    with pytest.raises(pwrfgs.InputError, match="trace the paths of this scene, with one antenna per transmitter"):
        convert.from_sionna(Sionna(), [0.0], scene)
    scene = Sionna()
    scene.cfr = lambda **settings: 0 * Sionna().cfr(**settings)
    with pytest.raises(pwrfgs.InputError, match="no transmitter has a path"):
        convert.from_sionna(scene, [0.0], scene, receiver="hall")


def snippet(word):
    """The code block of docs/data.md that contains ``word``."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs/data.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    return next(block for block in blocks if word in block)


def test_real_sionna_paths_give_spectra_with_the_line_of_sight(tmp_path, monkeypatch):
    try:
        import sionna.rt as rt

        rt.load_scene(rt.scene.box)
    except Exception as error:
        pytest.skip(f"Sionna RT does not run; pip install sionna-rt, and set DRJIT_LIBLLVM_PATH: {type(error).__name__}: {error}")
    monkeypatch.chdir(tmp_path)
    code = snippet("from_sionna").replace("range(200)", "range(5)")
    names = {}
    exec(code, names)
    assert pwrfgs.Dataset.load(tmp_path / "data/box").spectra.shape == (5, 90, 360)
    scene = names["scene"]
    scene.get("gateway").orientation = [0.3, -0.4, 0.2]
    scene.add(rt.Receiver("other", position=[3, 3, 2], orientation=[-2, 0.1, -0.5]))
    for synthetic in (True, False):
        paths = rt.PathSolver()(scene, max_depth=0, synthetic_array=synthetic)
        for name in ("gateway", "other"):
            assert_peaks_at_sources(convert.from_sionna(paths, [0.0, 1e6], scene, receiver=name))


@pytest.fixture()
def scenario(simulated, tmp_path):
    (tmp_path / "deepmimo_scenarios").mkdir()
    convert.to_deepmimo(simulated / "small.ron", tmp_path / "deepmimo_scenarios/small", samples=12, progress=False)
    return tmp_path / "deepmimo_scenarios/small"


def edit(scenario, name, change):
    """Changes a matrix of a scenario."""
    path = scenario / f"{name}_t000_tx000_r001.npz"
    with np.load(path) as arrays:
        values = np.array(arrays[name])
    np.savez(path, **{name: change(values)})


def test_simulated_channels_survive_deepmimo(simulated, scenario):
    wanted = pwrfgs.Dataset.load(simulated / "channels")
    hz = wanted.frequencies_hz
    data = convert.from_deepmimo(scenario, hz, observe="channel", receiver=wanted.receivers[0])
    assert np.array_equal(data.tx, wanted.tx) and data.receivers == wanted.receivers and data.simulated
    assert np.linalg.norm(data.csi - wanted.csi) < 1e-3 * np.linalg.norm(wanted.csi)
    spectra = convert.from_deepmimo(scenario, hz, receiver=wanted.receivers[0], every=5)
    assert np.array_equal(spectra.tx, wanted.tx[::5])
    theirs = pwrfgs.spectrum(wanted.csi[::5], wanted.receivers[0], hz)
    assert np.abs(spectra.spectra - theirs).max() < 0.01
    powers = convert.from_deepmimo(scenario, hz, observe="power", receiver=wanted.receivers[0], power_dbm=3.0)
    assert np.allclose(powers.rssi, 3 + 10 * np.log10((np.abs(wanted.csi) ** 2).mean(axis=(1, 2))), atol=0.01)
    default = convert.from_deepmimo(scenario, [2.39e9, 2.41e9], observe="channel")
    assert default.csi.shape == (12, 16, 2) and default.frequencies_hz.tolist() == [2.39e9, 2.41e9]
    with pytest.raises(pwrfgs.InputError, match="is not empty"):
        convert.to_deepmimo(simulated / "small.ron", scenario)
    with pytest.raises(pwrfgs.InputError, match="unknown value `deepmimo`"):
        pwrfgs.simulate(simulated / "small.ron", scenario.parent / "other", layout="deepmimo")
    assert [path.name for path in scenario.parent.iterdir()] == ["small"]


def test_users_keep_their_25_strongest_paths(tmp_path):
    panel = 'Panel(name: "p", from: (5, 1), to: (5, 5), heights: (0, 2.5), finish: (material: "glass", thickness_m: 0.01))'
    (tmp_path / "many.ron").write_text(SCENE.replace("room_order: 1", "room_order: 3").replace("receiver:", f"objects: [{panel}], receiver:"))
    pwrfgs.simulate(tmp_path / "many.ron", tmp_path / "many", layout="arrays", samples=5, paths=True, progress=False)
    convert.to_deepmimo(tmp_path / "many.ron", tmp_path / "scenario", samples=5, progress=False)
    names = ("power", "inter", "inter_pos", "delay", "rx_pos", "tx_pos")
    read = {name: np.load(tmp_path / f"scenario/{name}_t000_tx000_r001.npz")[name] for name in names}
    power, inter = read["power"], read["inter"]
    rows = [line.split(",") for line in (tmp_path / "many/paths.csv").read_text().splitlines()[1:]]
    assert {0, 14} <= set(inter.ravel())  # from the base station: reflected, then transmitted
    for user in range(5):
        mine = sorted((-float(row[5]), row[2]) for row in rows if int(row[0]) == user + 1)[:25]
        assert np.allclose(power[user], [-db for db, _ in mine], atol=2e-3)
        codes = [int(letters.replace("LOS", "0")[::-1].translate(str.maketrans("RDT", "124"))) for _, letters in mine]
        assert sorted(inter[user]) == sorted(codes)
        for path in np.flatnonzero(inter[user] > 0):  # the points are those of the path, in order
            met = read["inter_pos"][user, path]
            corners = np.concatenate([read["tx_pos"], met[np.isfinite(met[:, 0])], read["rx_pos"][[user]]])
            assert len(corners) == len(str(int(inter[user, path]))) + 2
            assert np.isclose(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum(), C * read["delay"][user, path], rtol=1e-6)


def test_paths_with_nan_and_users_without_paths_are_left_out(simulated, scenario):
    receiver = pwrfgs.Dataset.load(simulated / "channels").receivers[0]
    whole = convert.from_deepmimo(scenario, observe="channel", receiver=receiver)
    for name in ("power", "phase", "delay", "aod_az", "aod_el", "inter"):  # two more paths, of which nothing is known
        edit(scenario, name, lambda values: np.pad(values, ((0, 0), (2, 0)), constant_values=np.nan))
    edit(scenario, "power", lambda values: np.where(np.arange(12)[:, None] == 4, np.nan, values))
    (scenario / "inter_t000_tx000_r001.npz").unlink()
    with pytest.warns(UserWarning, match="1 of 12 transmitters have no path"):
        data = convert.from_deepmimo(scenario, observe="channel", receiver=receiver)
    rest = np.arange(12) != 4
    assert np.array_equal(data.tx, whole.tx[rest]) and np.allclose(data.csi, whole.csi[rest], rtol=1e-5)


def name_ray_tracer(scenario, name):
    """Replaces the name of the ray tracer of a scenario; None removes it."""
    params = json.loads((scenario / "params.json").read_text())
    params["rt_params"].pop("raytracer_name")
    if name is not None:
        params["rt_params"]["raytracer_name"] = name
    (scenario / "params.json").write_text(json.dumps(params))


def read(scenario, name):
    with np.load(scenario / f"{name}_t000_tx000_r001.npz") as arrays:
        return arrays[name].astype(float)


LAG = 360 * 2.4e9  # degrees per second of delay


@pytest.mark.parametrize(
    ("tracer", "lacks", "has_direct", "said"),
    [
        ("Sionna Ray Tracing", True, True, ""),
        ("Sionna Ray Tracing", True, False, ""),
        ("Remcom Wireless Insite", False, True, ""),
        ("Remcom Wireless Insite", False, False, ""),
        ("pwrfgs", True, True, "phases of pwrfgs contain the delay, but those of 12 direct paths lack it"),
        ("Sionna Ray Tracing", False, True, "phases of Sionna Ray Tracing lack the delay, but those of 12 direct paths contain it"),
        ("other", True, True, ""),
        ("other", False, True, ""),
        ("other", False, False, "the ray tracer 'other' is unknown, and 0 direct paths do not show whether"),
        (None, True, True, ""),
    ],
)
def test_phases_get_the_delay_that_their_ray_tracer_leaves_out(scenario, tracer, lacks, has_direct, said):
    if not has_direct:
        inter = read(scenario, "inter")
        edit(scenario, "power", lambda power: np.where(inter == 0, np.nan, power))
        edit(scenario, "inter", lambda _: np.where(inter == 0, np.nan, inter))
    power, phase, delay = (read(scenario, name) for name in ("power", "phase", "delay"))
    wanted = np.nansum(10 ** (power / 20) * np.exp(1j * np.deg2rad(phase)), axis=1)
    if lacks:
        edit(scenario, "phase", lambda phase: (phase + LAG * delay) % 360)
    name_ray_tracer(scenario, tracer)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        data = convert.from_deepmimo(scenario, observe="channel", receiver=pwrfgs.Receiver("bs", antennas=[(0, 0, 0)]))
    assert np.abs(data.csi[:, 0, 0] - wanted).max() < 1e-5 * np.abs(wanted).max()
    messages = [str(warning.message) for warning in told]
    assert len(messages) == bool(said) and all(said in message for message in messages), messages


@pytest.mark.skipif("PWRFGS_SHARED" not in os.environ, reason="needs the shared cases in PWRFGS_SHARED")
def test_shared_scenario_without_direct_paths_has_its_right_channels():
    folder = pathlib.Path(os.environ["PWRFGS_SHARED"]) / "cases/scenes/deepmimo-no-direct"
    re, im, _ = np.loadtxt(folder / "expected_channel_at_one_antenna.csv", delimiter=",", skiprows=1).T
    receiver = pwrfgs.Receiver("bs", antennas=[(0, 0, 0)])
    data = convert.from_deepmimo(folder, observe="channel", receiver=receiver)
    wanted = re + 1j * im
    assert (np.abs(data.csi[:, 0, 0] - wanted) < 1e-5 * np.abs(wanted)).all()


def test_few_direct_paths_do_not_contradict_a_known_ray_tracer(scenario):
    inter = read(scenario, "inter")
    edit(scenario, "inter", lambda _: np.where((inter == 0) & (np.arange(12)[:, None] > 2), 1.0, inter))
    whole = convert.from_deepmimo(scenario, observe="power")
    delay = read(scenario, "delay")
    edit(scenario, "phase", lambda phase: (phase + LAG * delay) % 360)
    name_ray_tracer(scenario, "SIONNA ray tracing")
    assert np.allclose(convert.from_deepmimo(scenario, observe="power").rssi, whole.rssi, atol=1e-3)
    name_ray_tracer(scenario, "other")
    with pytest.warns(UserWarning, match="only 3 direct paths decide"):
        assert np.allclose(convert.from_deepmimo(scenario, observe="power").rssi, whole.rssi, atol=1e-3)


def test_matlab_files_and_several_pairs_are_read(scenario):
    io = pytest.importorskip("scipy.io", reason="SciPy writes .mat files; pip install scipy")
    whole = convert.from_deepmimo(scenario, observe="power")
    for path in scenario.glob("*_t000_tx000_r001.npz"):
        name = path.name.split("_t000")[0]
        with np.load(path) as arrays:
            io.savemat(path.with_suffix(".mat"), {name: arrays[name]})
            np.savez(path.with_name(path.name.replace("r001", "r000")), **{name: arrays[name]})  # base station to base station
            np.savez(path.with_name(path.name.replace("tx000", "tx001")), **{name: arrays[name]})
        path.unlink()
    with pytest.raises(pwrfgs.InputError, match=r"pass pair=.., one of \(0, 0, 0\), \(0, 0, 1\), \(0, 1, 1\)"):
        convert.from_deepmimo(scenario)
    assert np.array_equal(convert.from_deepmimo(scenario, pair=(0, 0, 1), observe="power").rssi, whole.rssi)
    for path in scenario.glob("*tx001*"):
        path.unlink()
    assert np.array_equal(convert.from_deepmimo(scenario, observe="power").rssi, whole.rssi)
    (scenario / "phase_t000_tx000_r001.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(140))
    with pytest.raises(pwrfgs.InputError, match="phase_t000_tx000_r001.mat: no readable matrix `phase`.*of version 5") as told:
        convert.from_deepmimo(scenario)
    assert told.value.path == str(scenario / "phase_t000_tx000_r001.mat")


def carrier(scenario, text):
    params = (scenario / "params.json").read_text()
    (scenario / "params.json").write_text(re.sub(r'("frequency":) *[\d.e+]+', rf"\1 {text}", params))


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda s: (s / "params.json").write_text("{"), "params.json: not the parameters of a DeepMIMO v4 scenario"),
        (lambda s: (s / "params.json").write_text(json.dumps({"rt_params": {}})), "KeyError('frequency')"),
        (lambda s: (s / "params.json").unlink(), "no params.json and power_t000_tx000_r000.npz of DeepMIMO v4; give the folder"),
        (lambda s: (s / "delay_t000_tx000_r001.npz").unlink(), "delay_t000_tx000_r001.npz: no such file"),
        (lambda s: (s / "delay_t000_tx000_r001.npz").write_bytes(b"PK"), "no readable matrix `delay`"),
        (lambda s: edit(s, "delay", lambda x: x[:, 1:]), "delay has shape [12, 6], expected [12, 7]"),
        (lambda s: edit(s, "inter", lambda x: x[1:]), "inter has shape [11, 7], expected [12, 7]"),
        (lambda s: edit(s, "rx_pos", lambda x: x[:, :2]), "rx_pos has shape [12, 2], expected [12, 3]"),
        (lambda s: edit(s, "power", lambda x: x[0]), "power must have the axes users and paths"),
        (lambda s: edit(s, "power", lambda x: x * np.nan), "no transmitter has a path"),
        (lambda s: edit(s, "power", lambda x: x + 1e5), "power is in "),
        (lambda s: edit(s, "delay", lambda x: x - 1), "expected 0 to 1; correct the matrix"),
        (lambda s: edit(s, "phase", lambda x: x + 1j), "phase_t000_tx000_r001.npz: no readable matrix `phase` (its values are not real"),
        (lambda s: carrier(s, "-1"), "a frequency of -1 Hz"),
        (lambda s: carrier(s, "NaN"), "a frequency of nan Hz"),
        (lambda s: (s / "params.json").write_text("[" * 100_000), "not the parameters of a DeepMIMO v4 scenario"),
        (lambda s: (s / "params.json").write_text(" " * (1 << 24) + "{}"), "more than 16 MB"),
    ],
)
def test_damaged_scenarios_are_reported(scenario, damage, said):
    damage(scenario)
    with pytest.raises(pwrfgs.InputError) as told:
        convert.from_deepmimo(scenario)
    assert said in str(told.value)


def header(shape):
    text = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\0" + len(text).to_bytes(2, "little") + text.encode()


@pytest.mark.parametrize("content", ["claimed", "written", "cut", "long"])
def test_size_of_a_matrix_is_checked_before_memory_is_reserved(scenario, content):
    path = scenario / "delay_t000_tx000_r001.npz"
    shape = (1 << 21, 25) if content in ("claimed", "written") else (1 << 20, 25)
    count = {"claimed": 12, "written": 25 << 21, "cut": 12, "long": (25 << 20) + 1}[content]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive, archive.open("delay.npy", "w") as file:
        file.write(header(shape))
        for _ in range(count // (1 << 18)):
            file.write(bytes(1 << 20))
        file.write(bytes(4 * (count % (1 << 18))))
    said = {"cut": "no readable matrix", "long": "goes on after the matrix"}.get(content, "52,428,800 values, and at most 33,554,432")
    tracemalloc.start()
    with pytest.raises(pwrfgs.InputError, match=f"delay_t000_tx000_r001.npz: .*{said}"):
        convert.from_deepmimo(scenario)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < (50 << 20) or content in ("cut", "long")


def test_large_matrix_of_matlab_is_refused(scenario):
    io = pytest.importorskip("scipy.io", reason="SciPy writes .mat files; pip install scipy")
    path = scenario / "delay_t000_tx000_r001.npz"
    path.unlink()
    for value, said in [(np.zeros((1 << 21, 25), np.float32), "52,428,800 values"), (np.array(["a"]), "not real numbers")]:
        io.savemat(path.with_suffix(".mat"), {"delay": value}, do_compression=True)
        with pytest.raises(pwrfgs.InputError, match=f"delay_t000_tx000_r001.mat: .*{said}"):
            convert.from_deepmimo(scenario)


def test_every_flipped_bit_of_a_matrix_is_named(scenario):
    path = scenario / "phase_t000_tx000_r001.npz"
    good = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        size = archive.infolist()[0].compress_size
    begin = good.index(b"phase.npy") + len(b"phase.npy")
    for place in np.random.default_rng(0).integers(begin + 20, begin + size, 60):
        path.write_bytes(good[:place] + bytes([good[place] ^ 1 << (place % 8)]) + good[place + 1 :])
        with pytest.raises(pwrfgs.InputError, match="phase_t000_tx000_r001.npz: no readable matrix `phase`"):
            convert.from_deepmimo(scenario)
    edit(scenario, "power", lambda power: power)  # without compression
    path = scenario / "power_t000_tx000_r001.npz"
    good = bytearray(path.read_bytes())
    good[good.index(b"NUMPY") + 300] ^= 0x80
    path.write_bytes(good)
    with pytest.raises(pwrfgs.InputError, match="power_t000_tx000_r001.npz: .*Bad CRC-32.*download the scenario again"):
        convert.from_deepmimo(scenario)


@pytest.mark.parametrize("ending", ["npz", "mat"])
@pytest.mark.filterwarnings("ignore")
def test_mutated_scenarios_are_read_or_reported(scenario, ending):
    if ending == "mat":
        io = pytest.importorskip("scipy.io", reason="SciPy writes .mat files; pip install scipy")
        for path in list(scenario.glob("*_t000_tx000_r001.npz")):
            name = path.name.split("_t000")[0]
            io.savemat(path.with_suffix(".mat"), {name: read(scenario, name)}, do_compression=name > "e")
            path.unlink()
    rng, refused = np.random.default_rng(1), 0
    files = sorted([*scenario.glob(f"*_t000_tx000_r001.{ending}"), scenario / "params.json"])
    for case in range(300):
        path = files[case % len(files)]
        good = path.read_bytes()
        bad, (place, other) = bytearray(good), sorted(rng.integers(0, len(good), 2))
        kind = case // len(files) % 4
        if kind == 0:
            bad[place] ^= 1 << rng.integers(8)
        elif kind == 1:
            del bad[place:other]
        elif kind == 2:
            bad[place:place] = good[place:other]
        else:
            bad[place : place + 8] = rng.choice([b"\xff" * 8, b"\0" * 8, b"\x7f" + b"\xff" * 7, b"9" * 8])
        path.write_bytes(bad)
        try:
            data = convert.from_deepmimo(scenario, observe="channel")
            assert np.isfinite(data.csi).all() and np.isfinite(data.tx).all()
        except pwrfgs.InputError as error:
            refused += 1
            assert len(str(error)) < 2000
        path.write_bytes(good)
    assert 100 < refused < 300


def test_deepmimo_settings_and_sources_are_checked(scenario):
    for settings, said in [(dict(frequencies_hz=[0.0]), "near the carrier of the scenario, 2.4e\\+09 Hz"), (dict(every=0), "every is 0")]:
        with pytest.raises(pwrfgs.InputError, match=said):
            convert.from_deepmimo(scenario, **settings)
    for source in (3, {"power": np.zeros((2, 3))}, scenario / "nowhere"):
        with pytest.raises(pwrfgs.InputError, match="pass a folder|give the folder"):
            convert.from_deepmimo(source)
    with pytest.raises(pwrfgs.InputError, match="pass one of them, such as dataset\\[0\\]"):
        convert.from_deepmimo(types.SimpleNamespace(datasets=[]))


def test_page_of_data_has_a_round_trip_through_deepmimo(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    code = snippet("to_deepmimo")
    assert "samples=200" in code
    names = {}
    exec(code.replace("samples=200", "samples=5"), names)
    assert pwrfgs.Dataset.load(tmp_path / "data/office-deepmimo").spectra.shape == (5, 90, 360) and len(names["data"]) == 5


def test_channels_equal_those_of_the_package_deepmimo(scenario, monkeypatch):
    deepmimo = pytest.importorskip("deepmimo", reason="channels were not compared with DeepMIMO; pip install deepmimo")
    monkeypatch.chdir(scenario.parent.parent)
    count, hz = 64, 2.4e9 + 20e6 / 64 * np.arange(4)
    with contextlib.redirect_stdout(None):
        theirs = deepmimo.load("small")
        ofdm = {"subcarriers": count, "selected_subcarriers": np.arange(4), "bandwidth": 20e6}
        array = {"shape": [4, 3], "spacing": 0.45}
        channels = np.asarray(theirs.compute_channels(deepmimo.ChannelParameters(bs_antenna=array, ofdm=ofdm)))
    wanted = np.sqrt(count) * channels[:, 0]  # the package divides the power by the number of subcarriers
    step = 0.45 * C / 2.4e9
    antennas = [(step * x, step * y, 0.0) for y in range(3) for x in range(4)]
    receiver = pwrfgs.Receiver(orientation=(0.5, 0.5, 0.5, 0.5), antennas=antennas)
    for source in (theirs, scenario):
        data = convert.from_deepmimo(source, hz, observe="channel", receiver=receiver)
        scale = np.abs(wanted).max()
        assert np.abs(data.csi[..., 0] - wanted[..., 0]).max() < 1e-5 * scale
        # The package uses the wavelength of the carrier at all subcarriers; an antenna at the origin is not affected.
        assert np.abs(data.csi[:, 0] - wanted[:, 0]).max() < 1e-5 * scale and np.abs(data.csi - wanted).max() < 1e-2 * scale

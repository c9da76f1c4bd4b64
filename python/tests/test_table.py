"""Tables of received powers: files and data frames give the same data."""

import gzip
import json
import logging
import pickle
import subprocess

import numpy as np
import pytest

import pwrfgs

pandas = pytest.importorskip("pandas")

WIDE = "x,y,MAC1,MAC2,MAC3\n0,0,-40,-50,100\n0,3,100,-55,100\n4,3,-61,-52,100\n"


def same(a, b):
    assert a.receivers == b.receivers
    for name in ("tx", "rssi", "receiver", "ids"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.fixture
def survey(tmp_path):
    path = tmp_path / "survey.csv"
    path.write_text(WIDE)
    return path


def test_frame_and_files_give_the_same_data(survey, tmp_path, caplog):
    with caplog.at_level(logging.INFO, logger="pwrfgs"):
        data = pwrfgs.Dataset.from_table(survey, missing=100, title="hall")
    assert "powers of 3 receivers in columns" in caplog.text
    assert [receiver.name for receiver in data.receivers] == ["MAC1", "MAC2"]
    np.testing.assert_array_equal(data.rssi, [-40, -50, -55, -61, -52])
    frame = pandas.read_csv(survey)
    same(data, pwrfgs.Dataset.from_table(frame, missing=[100.0], title="hall"))
    same(data, pwrfgs.Dataset.from_table(frame.replace(100, np.nan), title="hall"))
    (tmp_path / "survey.csv.gz").write_bytes(gzip.compress(WIDE.encode()))
    same(data, pwrfgs.Dataset.from_table(str(tmp_path / "survey.csv.gz"), missing=100, title="hall"))
    data.save(tmp_path / "saved")
    same(data, pwrfgs.Dataset.load(tmp_path / "saved"))


def test_columns_of_a_frame_are_chosen(tmp_path):
    frame = pandas.DataFrame({0: [0.0, 1.0], 1: [2.0, 2.0], "rssi": [-40.0, -50.0], "snr": [20, 9]})
    receivers = pandas.DataFrame({"name": ["roof"], "x": [5.0], "y": [6.0], "z": [7.0]})
    data = pwrfgs.Dataset.from_table(frame, x=0, y=1, receiver="roof", receivers=receivers, height=1.5)
    assert data.receivers[0].name == "roof" and tuple(data.receivers[0].position) == (5.0, 6.0, 7.0)
    np.testing.assert_array_equal(data.tx, [[0, 2, 1.5], [1, 2, 1.5]])
    test = pandas.DataFrame({0: [3.0], 1: [2.0], "rssi": [-45.0]})
    data = pwrfgs.Dataset.from_table(frame, x=0, y=1, test=test)
    assert list(data.split().test) == [2]


def test_degrees_are_known(tmp_path):
    frame = pandas.DataFrame({"lat": [48.137, 48.138], "lon": [11.575, 11.575], "ap": ["a", "a"], "rssi": [-40, -50]})
    data = pwrfgs.Dataset.from_table(frame)
    assert abs(np.diff(data.tx[:, 1])[0] - 111.2) < 0.1


@pytest.mark.parametrize(
    "options, words",
    [
        ({"unit": "dB"}, "unit=dB: expected dBm"),
        ({"colums": "MAC*"}, "from_table has no option `colums`"),
        ({"power": "rss"}, "power rss: no such column"),
    ],
)
def test_wrong_options_are_errors(survey, options, words):
    with pytest.raises(pwrfgs.InputError, match=words):
        pwrfgs.Dataset.from_table(survey, missing=100, **options)
    with pytest.raises(pwrfgs.InputError, match="path of a file, or a pandas DataFrame"):
        pwrfgs.Dataset.from_table(3)


def test_findings_are_errors_unless_accepted(tmp_path):
    rows = [f"{k},{j},{-40 - k - j / 3:.1f}" for k in range(8) for j in range(8)] + ["9,9,100"] * 4
    path = tmp_path / "codes.csv"
    path.write_text("\n".join(["x,y,rssi", *rows]))
    with pytest.raises(pwrfgs.InputError, match="lone-value: of 68 received powers, 4 are 100") as error:
        pwrfgs.Dataset.from_table(path)
    assert "accept=lone-value" in str(error.value)
    with pytest.warns(UserWarning, match="lone-value"):
        data = pwrfgs.Dataset.from_table(path, accept=["lone-value"])
    assert len(data) == 68
    data.save(tmp_path / "accepted")
    assert '"lone-value"' in (tmp_path / "accepted" / "manifest.json").read_text()
    assert len(pwrfgs.Dataset.from_table(path, missing=100)) == 64


def test_frame_and_command_line_give_the_same_data(tmp_path, cli):
    frame = pandas.DataFrame({"x": [0, 1, 0, 1], "y": 0.0, "floor": [0, 0, 2, 2], "a1": [-40, -45, -60, 1], "a2": -50.5})
    frame.to_csv(tmp_path / "a.csv", index=False, sep=";", decimal=",")
    options = ["--missing", "1", "--floor-height", "3.5", "--height", "1", "--name", "hall"]
    command = ["import", "--table", str(tmp_path / "a.csv"), *options, "--out", str(tmp_path / "out"), "-q"]
    subprocess.run([cli, *command], check=True)
    data = pwrfgs.Dataset.from_table(frame, missing=1, floor_height=3.5, height=1, title="hall")
    same(data, pwrfgs.Dataset.load(tmp_path / "out"))
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["floors"] == {"0": 1.0, "2": 8.0}
    assert pickle.loads(pickle.dumps(data))._digest == data._digest


def test_pickles_know_what_was_estimated():
    frame = pandas.DataFrame({"lat": [48.137, 48.138], "lon": [11.575, 11.575], "ap": ["a", "a"], "rssi": [-40, -50]})
    data = pwrfgs.Dataset.from_table(frame)
    again = pickle.loads(pickle.dumps(data))
    same(again, data)
    assert again._digest == data._digest, "the digest covers the degrees and the estimated receiver"

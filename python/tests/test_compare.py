"""`compare`: its result, its arguments, and what it refuses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from test_equal import made
from test_tasks import check_result

import pwrfgs

SHORT = {"training.scale": 0.002}


@pytest.fixture(scope="module")
def powers(tmp_path_factory):
    data = made("powers")
    data.save(tmp_path_factory.mktemp("data") / "powers")
    return data


def test_compare_trains_and_scores(powers, tmp_path):
    planned = pwrfgs.compare(powers, seeds=2, methods="P-WRFGS", set=SHORT, out=tmp_path / "out", dry_run=True)
    assert planned.runs == [] and planned.rows == [] and "2 runs of 1 combinations" in str(planned)
    assert not (tmp_path / "out").exists()
    predicted = tmp_path / "mine"
    predicted.mkdir()
    assert len(planned.test_ids) == len(planned.split.test)
    (predicted / "predictions.csv").write_text("link,dbm\n" + "".join(f"{link},-60\n" for link in planned.test_ids))
    result = pwrfgs.compare(
        powers, seeds=2, methods=["P-WRFGS"], predictions={"U-Net": predicted}, set=SHORT, out=tmp_path / "out"
    )  # fmt: skip
    assert [run.finished for run in result.runs] == [True, True] and result.folder == str(tmp_path / "out")
    assert all(np.array_equal(one, other) for one, other in zip(result.split, planned.split))
    kinds = {row["variant"]: row["kind"] for row in result.rows}
    assert kinds["method P-WRFGS"] == "variant" and kinds["U-Net"] == "external" and "Kriging" in kinds
    first = result.rows[0]
    assert first["n"] == 2 and math.isfinite(first["value"]) and first["simulated"] is False
    check_result(result, ["variant", "metric", "statistic", "value"], len(result.rows))
    assert (tmp_path / "out/report/report.html").is_file()


def test_compare_of_data_in_memory_writes_them_into_its_folder(tmp_path):
    pwrfgs.compare(made("powers"), seeds=1, methods="P-WRFGS", set=SHORT, out=tmp_path / "out", keep_checkpoint=True)
    (folder,) = (tmp_path / "out/data").iterdir()
    assert str(folder) in (tmp_path / "out/method=P-WRFGS,seed=0/pipeline.ron").read_text()
    assert (tmp_path / "out/method=P-WRFGS,seed=0/checkpoint.safetensors").is_file()


def test_compare_refuses(powers, run, tmp_path):
    for call, problem in [
        (lambda: pwrfgs.compare([run, run]), "data: expected a Dataset or a data folder; pwrfgs.report compares finished runs"),
        (lambda: pwrfgs.compare(tmp_path / "none"), "no such folder"),
        (lambda: pwrfgs.compare(powers, seeds=0), "seeds 0: expected a number from 1 to 1024"),
        (lambda: pwrfgs.compare(powers, methods=["P-WRGFS"]), "no such method for these data; did you mean `P-WRFGS`?"),
        (lambda: pwrfgs.compare(powers, sedes=1), "compare has no field `sedes`; did you mean `seeds`?"),
        (lambda: pwrfgs.compare(powers, predictions={"mine": tmp_path / "none"}), "predictions mine="),
        (lambda: pwrfgs.compare(powers, methods=["P-WRFGS"], set={"training.stesp": 1}), "stesp"),
    ]:
        with pytest.raises(pwrfgs.InputError) as error:
            call()
        assert problem in str(error.value) and "--" not in str(error.value)

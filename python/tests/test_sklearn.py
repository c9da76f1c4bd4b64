"""The estimators of scikit-learn."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from conftest import SMALL

import pwrfgs

base = pytest.importorskip("sklearn.base", reason="scikit-learn is not installed")
checks = pytest.importorskip("sklearn.utils.estimator_checks")
selection = pytest.importorskip("sklearn.model_selection")
preprocessing = pytest.importorskip("sklearn.preprocessing")
make_pipeline = pytest.importorskip("sklearn.pipeline").make_pipeline

QUICK = {"training.validate_every": 0, "training.steps": 40}
FEW = "steps: {steps}, batch: {batch}, densify_until: 0, prune_until: 0, validate_every: 0"
POWER = """Pipeline(
    name: "powers", data: Nerf2Rssi(root: "unused"), readout: ReceivedPower(), initializer: Random(count: 20, std: 3.0),
    deformation: Factored(depth: 1, width: 8), metrics: [PowerError()], baselines: [], training: ({training}),
)"""
CHANNEL = """Pipeline(
    name: "channels", data: Channels(root: "unused"), method: VirtualTransmitters(order: 1),
    initializer: MatchingPursuit(most: 2, reach: 1.0, step: 0.5, patience: 2, rounds: 0), training: ({training}),
)"""
GATEWAYS = [(0.0, 0.0, 2.0), (5.0, 0.0, 2.0), (2.0, 4.0, 2.0)]


@pytest.fixture(scope="module")
def powers():
    """Positions [60, 3] and powers [60, 3]."""
    rng = np.random.default_rng(0)
    tx = rng.uniform(0, 5, (60, 3))
    return tx, -40 - 20 * np.log10(np.linalg.norm(tx[:, None] - GATEWAYS, axis=2) + 0.1) + rng.normal(size=(60, 3))


def power_regressor(steps=60, batch=16, **parameters):
    text = POWER.format(training=FEW.format(steps=steps, batch=batch))
    return pwrfgs.sklearn.PowerRegressor(text, **{"receivers": GATEWAYS, **parameters})


def test_estimator_learns_and_is_searched(dataset):
    tx, spectra = dataset.tx, dataset.spectra
    own = pwrfgs.sklearn.SpectrumRegressor(SMALL, set=QUICK, receiver=dataset.receivers[0])
    with pytest.raises(ValueError, match="not fitted"):
        own.predict(tx)
    assert base.clone(own).get_params()["set"] == QUICK
    found = own.fit(tx[:80], spectra[:80]).predict(tx[80:])
    assert found.shape == spectra[80:].shape
    mean = pwrfgs.metrics.ssim(np.broadcast_to(spectra[:80].mean(0), found.shape), spectra[80:]).mean()
    assert own.score(tx[80:], spectra[80:]) == pytest.approx(pwrfgs.metrics.ssim(found, spectra[80:]).mean())
    assert own.score(tx[80:], spectra[80:]) > 0.1 and np.isfinite(mean)
    few = {**QUICK, "training.steps": 1, "training.densify_until": 0, "training.prune_until": 0}
    search = selection.GridSearchCV(own, {"set": [QUICK, few]}, cv=2)
    search.fit(tx, spectra)
    assert search.best_params_["set"] == QUICK


def test_rows_of_spectra_have_the_usual_scorers(dataset):
    tx, spectra = dataset.tx, dataset.spectra
    rows = spectra.reshape(len(spectra), -1)
    own = pwrfgs.sklearn.SpectrumRegressor(SMALL, set=QUICK, receiver=dataset.receivers[0])
    with pytest.raises(pwrfgs.InputError, match=r"y has shape \[120, 900\]; set shape to \(rows, columns\)"):
        own.fit(tx, rows)
    images = own.fit(tx, spectra).predict(tx[:5])
    own.set_params(shape=spectra.shape[1:]).fit(tx, rows)
    assert np.array_equal(own.predict(tx[:5]), images.reshape(5, -1))
    assert own.score(tx[:5], rows[:5]) == pytest.approx(pwrfgs.metrics.ssim(images, spectra[:5]).mean())
    assert np.isfinite(selection.cross_val_score(own, tx, rows, scoring="r2", cv=2)).all()
    with pytest.raises(pwrfgs.InputError, match=r"y has shape \[120, 899\], expected \[M, 900\] since shape is \(15, 60\)"):
        own.fit(tx, rows[:, 1:])


def test_powers_have_scorers_and_deviations(powers):
    tx, rssi = powers
    own = power_regressor()
    assert np.isfinite(selection.cross_val_score(own, tx, rssi, scoring="neg_mean_squared_error", cv=2)).all()
    plain = base.RegressorMixin.score(own.fit(tx, rssi), tx, rssi)
    assert own.score(tx, rssi) == pytest.approx(plain) and plain > 0.5
    mean, deviation = own.predict(tx[:4], return_std=True)
    assert np.array_equal(mean, own.predict(tx[:4])) and deviation.shape == (4, 3)
    assert 0.5 < deviation.min() and deviation.max() < 6  # the noise has 1 dB
    restored = pickle.loads(pickle.dumps(own))
    assert np.array_equal(restored.predict(tx[:4], return_std=True), (mean, deviation))
    # With a residual process, they depend on the position.
    kriged = power_regressor(set={"residuals": pwrfgs.Pipeline(SMALL).set({"residuals": {}}).residuals}).fit(tx, rssi)
    near, far = kriged.predict([tx[0], [9.0, 9, 9]], return_std=True)[1][:, 0]
    assert near < far
    gaps = np.where(np.arange(60)[:, None] % 7 == [0, 8, 8], np.nan, rssi)  # not received
    assert own.fit(tx, gaps).score(tx, gaps) > 0.5
    one = power_regressor(receivers=GATEWAYS[:1]).fit(tx, rssi[:, 0])
    assert one.predict(tx[:4]).shape == one.predict(tx[:4], return_std=True)[1].shape == (4,)
    for parameters, words in (
        ({"validation_fraction": 0}, "needs 3 held-out positions, and fit held out 0; raise validation_fraction"),
        ({"validation_fraction": 1.0}, "validation_fraction is 1.0, expected 0 to below 1"),
    ):
        with pytest.raises(pwrfgs.InputError, match=words):
            power_regressor(steps=1, batch=1, **parameters).fit(tx, rssi).predict(tx, return_std=True)


def test_channels_are_complex_or_rows_of_real_numbers():
    rng = np.random.default_rng(0)
    tx, hz = rng.uniform(0, 3, (30, 3)), [2.40e9, 2.41e9, 2.42e9]
    receiver = pwrfgs.Receiver(position=(1.0, 1.0, 4.0), antennas=[(0.0, 0.0, 0.0), (0.06, 0.0, 0.0)])
    antennas = np.add(receiver.position, receiver.antennas)
    metres = np.linalg.norm(tx[:, None] - antennas, axis=2)[:, :, None]
    csi = (np.exp(-2j * np.pi * metres * hz / 299_792_458) / metres).astype(np.complex64)  # [M, A, F]
    text = CHANNEL.format(training=FEW.format(steps=2, batch=10))
    own = pwrfgs.sklearn.ChannelRegressor(text, receiver=receiver, frequencies_hz=hz).fit(tx, csi)
    found = own.predict(tx[:4])
    assert found.shape == (4, 2, 3) and np.iscomplexobj(found)
    assert own.score(tx, csi) == pytest.approx(pwrfgs.metrics.channel_snr(own.predict(tx), csi).mean())
    rows = csi.view(np.float32).reshape(30, -1)
    flat = base.clone(own).set_params(shape=(2, 3)).fit(tx, rows)
    assert np.array_equal(flat.predict(tx[:4]), found.view(np.float32).reshape(4, -1))
    assert flat.score(tx, rows) == pytest.approx(own.score(tx, csi))
    assert np.isfinite(selection.cross_val_score(flat, tx, rows, scoring="r2", cv=2)).all()
    with pytest.raises(pwrfgs.InputError, match="y is complex, but shape is set"):
        flat.fit(tx, csi)


def test_settings_are_parameters(powers):
    tx, rssi = powers
    own = power_regressor(steps=20)
    assert own.set_params(training__steps=3, seed=1) is own
    assert own.set == {"training.steps": 3} and own.seed == 1 and own.get_params()["training__steps"] == 3
    assert base.clone(own).get_params()["set"] == {"training.steps": 3}
    search = selection.GridSearchCV(own, {"training__steps": [1, 60], "deformation__width": [16]}, cv=2, scoring="r2")
    assert search.fit(tx, rssi).best_params_ == {"training__steps": 60, "deformation__width": 16}
    with pytest.raises(ValueError, match="Invalid parameter 'trainning'"):
        own.set_params(trainning__steps=3)
    with pytest.raises(pwrfgs.InputError, match="stepz"):
        own.set_params(training__stepz=3).fit(tx, rssi)


@pytest.mark.parametrize("scaler", ["StandardScaler", "MinMaxScaler"])
def test_scalers_are_refused(powers, scaler):
    tx, rssi = powers
    chain = make_pipeline(getattr(preprocessing, scaler)(), power_regressor())
    with pytest.raises(pwrfgs.InputError, match="as after a scaler, but positions must be in metres"):
        chain.fit(tx, rssi)


def test_default_pipeline_fits_the_sample(tmp_path, monkeypatch):
    monkeypatch.setattr(pwrfgs.datasets, "_SAMPLE", str(tmp_path / "sample"))
    pwrfgs.datasets._make_sample()
    data = pwrfgs.datasets.sample()
    own = pwrfgs.sklearn.SpectrumRegressor().set_params(training__scale=0.001)
    assert own.fit(data.tx, data.spectra).predict(data.tx[:2]).shape == data.spectra[:2].shape


# Checks of scikit-learn that cannot pass, by reason.
COLUMNS = {"X has other than three columns": """
    check_dtype_object check_estimators_dtypes check_estimators_fit_returns_self check_estimators_overwrite_params
    check_fit2d_1feature check_fit2d_1sample check_fit_check_is_fitted check_fit_idempotent check_n_features_in
    check_n_features_in_after_fitting check_positive_only_tag_during_fit check_readonly_memmap_input
    check_regressor_data_not_an_array check_regressor_multioutput check_regressors_int
    check_regressors_no_decision_function check_regressors_train"""}  # fmt: skip
OBSERVATIONS = {"y is neither spectra nor channels": """
    check_dict_unchanged check_dont_overwrite_parameters check_estimators_nan_inf check_estimators_pickle
    check_f_contiguous_array_estimator check_fit2d_predict1d check_fit_score_takes_y check_methods_sample_order_invariance
    check_methods_subset_invariance check_pipeline_consistency"""}  # fmt: skip
THREE = {
    "y of type object is refused": "check_dtype_object",
    "scaled positions are refused": "check_regressors_train check_regressor_data_not_an_array",
    "y has a column per receiver": "check_regressor_multioutput",
}


@pytest.mark.parametrize("kind", ["spectrum", "power", "power of three columns", "channel"])
@pytest.mark.filterwarnings("ignore")
def test_conventions_of_scikit_learn(kind, monkeypatch):
    if not hasattr(checks, "estimator_checks_generator"):
        pytest.skip("check_estimator of scikit-learn below 1.6 has no expected failures")
    reasons = COLUMNS if kind == "power" else THREE if "three" in kind else {**COLUMNS, **OBSERVATIONS}
    expected = {name: reason for reason, names in reasons.items() for name in names.split()}
    if "three" in kind:
        checked = pwrfgs.sklearn.validate_data

        def three_columns(estimator, X, **rules):
            found = checked(estimator, X, **rules)
            return np.pad(found, ((0, 0), (0, max(0, 3 - found.shape[1]))))[:, :3]

        monkeypatch.setattr(pwrfgs.sklearn, "validate_data", three_columns)
    estimator = {
        "spectrum": lambda: pwrfgs.sklearn.SpectrumRegressor(SMALL, shape=(1, 1)),
        "channel": lambda: pwrfgs.sklearn.ChannelRegressor(SMALL, frequencies_hz=[2.4e9], shape=(1, 1)),
    }.get(kind, lambda: power_regressor(steps=3, batch=1, receivers=GATEWAYS[:1], validation_fraction=0.0))()
    results = checks.check_estimator(estimator, expected_failed_checks=expected, on_skip=None)
    assert {result["check_name"] for result in results if result["status"] == "xfail"} <= set(expected)
    assert sum(result["status"] == "passed" for result in results) > 15

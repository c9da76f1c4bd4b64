"""The estimator of scikit-learn."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import SMALL

import pwrfgs

base = pytest.importorskip("sklearn.base", reason="scikit-learn is not installed")
selection = pytest.importorskip("sklearn.model_selection")


def test_estimator_learns_and_is_searched(dataset):
    tx, spectra = dataset.tx, dataset.spectra
    quick = {"training.validate_every": 0, "training.steps": 40}
    own = pwrfgs.sklearn.SpectrumRegressor(SMALL, set=quick, receiver=dataset.receivers[0])
    with pytest.raises(ValueError, match="call fit first"):
        own.predict(tx)
    assert base.clone(own).get_params()["set"] == quick
    found = own.fit(tx[:80], spectra[:80]).predict(tx[80:])
    assert found.shape == spectra[80:].shape
    mean = pwrfgs.metrics.ssim(np.broadcast_to(spectra[:80].mean(0), found.shape), spectra[80:]).mean()
    assert own.score(tx[80:], spectra[80:]) == pytest.approx(pwrfgs.metrics.ssim(found, spectra[80:]).mean())
    assert own.score(tx[80:], spectra[80:]) > 0.1 and np.isfinite(mean)
    search = selection.GridSearchCV(own, {"set": [quick, {**quick, "training.steps": 1, "training.densify_until": 0, "training.prune_until": 0}]}, cv=2)
    search.fit(tx, spectra)
    assert search.best_params_["set"] == quick

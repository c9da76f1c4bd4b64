"""Metrics, baselines, kernels: against NumPy, scikit-image and central differences."""

from __future__ import annotations

import numpy as np
import pytest

import pwrfgs
from gaussians import POSE, N, gaussians

RNG = np.random.default_rng(0)
P, T = RNG.uniform(size=(4, 30, 40)).astype(np.float32), RNG.uniform(size=(4, 30, 40)).astype(np.float32)


def test_metrics_against_numpy():
    assert np.allclose(pwrfgs.metrics.l1(P, T), np.abs(P - T).mean((1, 2)), rtol=1e-5)
    assert np.allclose(pwrfgs.metrics.psnr(P, T), -10 * np.log10(((P - T) ** 2).mean((1, 2))), rtol=1e-4)
    rate = lambda p: np.log2(1 + 10 ** 0.3 * p)  # noqa: E731
    want = [rate(t.ravel()[p.argmax()]) / rate(t.max()) for p, t in zip(P, T)]
    assert np.allclose(pwrfgs.metrics.eta(P, T, snr_db=3.0), want, rtol=1e-5)
    assert pwrfgs.metrics.ssim(P[0], P[0]) == 1.0 and isinstance(pwrfgs.metrics.ssim(P[0], T[0]), float)
    assert np.allclose(pwrfgs.metrics.power_error([-60.0, -70.0], [-61.5, -70.0]), [1.5, 0.0])
    h, g = RNG.normal(size=(3, 2, 5)) + 1j * RNG.normal(size=(3, 2, 5)), RNG.normal(size=(3, 2, 5)) + 0j
    want = 10 * np.log10((np.abs(h) ** 2).sum((1, 2)) / (np.abs(g - h) ** 2).sum((1, 2)))
    assert np.allclose(pwrfgs.metrics.channel_snr(g, h), want, rtol=1e-4)
    a, b = RNG.normal(size=(20, 3)), RNG.normal(size=(30, 3))
    d = ((a[:, None] - b[None]) ** 2).sum(-1)
    assert np.isclose(pwrfgs.metrics.chamfer(a, b), d.min(0).mean() + d.min(1).mean(), rtol=1e-5)
    one = np.zeros((30, 40))
    one[3, 5] = 1
    other = np.zeros((30, 40))
    other[3, 7] = 1
    el, az = np.deg2rad(9.0), np.deg2rad([45.0, 63.0])
    u = [np.array([np.cos(el) * np.cos(x), np.cos(el) * np.sin(x), np.sin(el)]) for x in az]
    assert np.isclose(pwrfgs.metrics.direction_error(one, other), np.degrees(np.arccos(u[0] @ u[1])), atol=1e-3)


def test_ssim_is_that_of_scikit_image():
    skimage = pytest.importorskip("skimage.metrics")
    want = [skimage.structural_similarity(p, t, data_range=1.0) for p, t in zip(P, T)]
    assert np.allclose(pwrfgs.metrics.ssim(P, T), want, atol=2e-5)


def test_metrics_refuse_what_does_not_fit():
    for given, said in [((P, T[:2]), "differ in shape"), ((P[:, :3], T), "differ in shape"), ((P[0, 0], T[0, 0]), "a spectrum has 2"), ((P[:0], T[:0]), "empty")]:
        with pytest.raises(pwrfgs.InputError) as told:
            pwrfgs.metrics.ssim(*given)
        assert said in str(told.value)
    with pytest.raises(pwrfgs.InputError):
        pwrfgs.metrics.chamfer(np.zeros((0, 3)), np.zeros((1, 3)))


def test_baselines_against_numpy(dataset):
    train = np.arange(0, len(dataset), 2)
    at = dataset.tx[1:6]
    mean = pwrfgs.baselines.mean(dataset, at, train)
    assert np.allclose(mean, dataset.spectra[train].mean(0), atol=1e-5) and mean.shape == (5, 15, 60)
    nearest = ((dataset.tx[train][None] - at[:, None]) ** 2).sum(-1).argmin(1)
    assert np.allclose(pwrfgs.baselines.knn(dataset, at, train, k=1), dataset.spectra[train][nearest], atol=1e-6)
    assert np.allclose(pwrfgs.baselines.knn(dataset, dataset.tx[:1], k=5)[0], dataset.spectra[0], atol=1e-5)
    with pytest.raises(pwrfgs.InputError, match="no training links"):
        pwrfgs.baselines.mean(dataset, at, [])
    rssi = -40 - 20 * np.log10(np.linalg.norm(dataset.tx, axis=1) + 0.1)
    powers = pwrfgs.Dataset.from_arrays(dataset.tx, rssi=rssi, receivers=[[0, 0, 0]])
    assert np.abs(pwrfgs.baselines.log_distance(powers, at) - rssi[1:6]).mean() < 2


def test_repeatability(dataset):
    found = pwrfgs.repeatability(dataset)
    assert set(found) == {"near", "far"} and "pairs" in found["near"] and ("mean" in found["near"]["ssim"] or "why_not" in found["near"]["ssim"])


def test_drawing():
    given = gaussians()
    splats = pwrfgs.project(given["means"], given["quats"], given["scales"], given["opacities"], POSE, 24, 96)
    assert splats.means2d.shape == (N, 2) and (splats.radii > 0).any()
    assert np.allclose(splats.depths, np.linalg.norm(given["means"] - POSE.position, axis=1), rtol=1e-4)
    picture = pwrfgs.rasterize(**given, pose=POSE, height=24, width=96)
    assert picture.shape == (2, 24, 96) and np.isfinite(picture).all() and np.abs(picture).max() > 0
    waves = pwrfgs.rasterize(**{**given, "signals": given["signals"] @ [1, 1j]}, pose=POSE, height=24, width=96)
    assert np.allclose(waves.real, picture[0]) and np.allclose(waves.imag, picture[1])
    doubled = {**given, "quats": 2 * given["quats"]}
    assert np.allclose(pwrfgs.rasterize(**doubled, pose=POSE, height=24, width=96), picture, atol=1e-5)
    array = pwrfgs.rasterize(**{**given, "signals": given["signals"] @ [1, 1j]}, pose=POSE, height=24, width=96, rasterizer=pwrfgs.ArrayResponse())
    assert np.iscomplexobj(array) and np.abs(array).max() > 0
    for change, said in [
        (dict(means=np.zeros((N, 2))), "means has shape"), (dict(opacities=np.ones(N)), "outside the range from 0 to below 1"),
        (dict(quats=np.zeros((N, 4))), "quats[0] is zero"), (dict(scales=np.full((N, 3), np.nan)), "scales holds NaN"),
        (dict(signals=np.zeros((N + 1, 2))), "signals has shape"),
    ]:
        with pytest.raises(pwrfgs.InputError) as told:
            pwrfgs.rasterize(**{**given, **change}, pose=POSE, height=24, width=96)
        assert said in str(told.value)
    with pytest.raises(pwrfgs.InputError, match="pose"):
        pwrfgs.rasterize(**given, pose=((0, 0, 0), (0, 0, 0, 3)))
    with pytest.raises(pwrfgs.InputError, match="cannot be rendered"):
        pwrfgs.rasterize(**given, pose=POSE, height=0)


@pytest.mark.skipif(pwrfgs._pwrfgs.real_bytes == 4, reason="single precision; the test command runs it in double too")
@pytest.mark.parametrize("rasterizer", ["AlphaBlending", "ArrayResponse"])
def test_derivatives_by_central_differences(rasterizer):
    given, weights = gaussians(1), np.random.default_rng(2).normal(size=(2, 24, 96))

    def loss(values):
        return (pwrfgs.rasterize(**values, pose=POSE, height=24, width=96, rasterizer=rasterizer) * weights).sum()

    _, vjp = pwrfgs.rasterize_with_vjp(**given, pose=POSE, height=24, width=96, rasterizer=rasterizer)
    for name, found in zip(given, vjp(weights)):
        want, step = np.zeros_like(given[name]), 1e-6
        for place in np.ndindex(want.shape):
            ends = []
            for sign in (1, -1):
                moved = {key: value.copy() for key, value in given.items()}
                moved[name][place] += sign * step
                ends.append(loss(moved))
            want[place] = (ends[0] - ends[1]) / (2 * step)
        # A pixel where a Gaussian crosses 1/255 between the two ends is a step, not a slope.
        close = np.isclose(found, want, rtol=1e-4, atol=1e-6 * np.abs(want).max())
        assert close.mean() > 0.95, (name, found, want)


@pytest.mark.skipif(pwrfgs._pwrfgs.real_bytes == 4, reason="single precision; the test command runs it in double too")
@pytest.mark.parametrize("rasterizer", ["AlphaBlending", "ArrayResponse"])
def test_derivatives_in_the_pose_by_central_differences(rasterizer):
    given, weights = gaussians(1), np.random.default_rng(2).normal(size=(2, 24, 96))
    settings = dict(height=24, width=96, rasterizer=rasterizer)
    flat, step = np.concatenate([np.array(part) for part in POSE]), 1e-6

    def image(pose):
        return pwrfgs.rasterize(**given, pose=(pose[:3], pose[3:] / np.linalg.norm(pose[3:])), **settings)

    _, vjp = pwrfgs._kernels.rasterize_with_pose_vjp(**given, pose=POSE, **settings, projector="Mercator", elevation_deg=(0.0, 90.0))
    for k in range(7):
        slope = (image(flat + step * (np.arange(7) == k)) - image(flat - step * (np.arange(7) == k))) / (2 * step)
        # A pixel where a Gaussian crosses 1/255 between the two ends is a step, not a slope.
        smooth = (np.abs(slope) < 500).all(axis=0)
        assert smooth.mean() > 0.99
        found = np.concatenate(vjp(weights * smooth)[5:])
        assert np.isclose(found[k], (slope * weights * smooth).sum(), rtol=1e-5, atol=1e-5), k


def test_torch():
    pytest.importorskip("torch")
    import gradcheck

    gradcheck.main()


def test_metrics_have_the_shape_of_their_samples():
    for metric, shape in [("power_error", ()), ("channel_snr", (2, 5)), ("ssim", (8, 9))]:
        measure = getattr(pwrfgs.metrics, metric)
        p, t = RNG.uniform(size=(2, 3, *shape)), RNG.uniform(size=(2, 3, *shape))
        found = measure(p, t)
        assert found.shape == (2, 3) and np.isclose(found[1, 2], measure(p[1, 2], t[1, 2]))
        with pytest.raises(pwrfgs.InputError, match="differ in shape"):
            measure(p, t.swapaxes(0, 1))


def test_drawing_nothing_and_too_much():
    nothing = {name: column[:0] for name, column in gaussians().items()}
    assert pwrfgs.rasterize(**{**nothing, "signals": np.zeros((0, 5))}, pose=POSE, height=4, width=16).shape == (5, 4, 16)
    assert pwrfgs.rasterize(**{**nothing, "signals": np.zeros(0, complex)}, pose=POSE, height=4, width=16).shape == (4, 16)
    with pytest.raises(pwrfgs.InputError, match="no channel"):
        pwrfgs.rasterize(**{**gaussians(), "signals": np.zeros((N, 0))}, pose=POSE)
    one = {name: column[:1] for name, column in gaussians().items()}
    with pytest.raises(MemoryError):
        pwrfgs.rasterize(**{**one, "signals": np.ones((1, 1 << 20), np.float32)}, pose=POSE, height=9000, width=9000)


def test_drawing_says_what_it_wants(dataset):
    one = gaussians()
    for change, said in [
        ({"scales": np.zeros((N, 3))}, "metres above 0"),
        ({"signals": np.ones(N)}, r"give complex ones \[N\], or real ones \[N, C\]"),
        ({"pose": (0, 0, 0)}, "give a Pose"),
        ({"pose": ((0, 0), (0, 0, 0, 1))}, "give a Pose"),
    ]:
        with pytest.raises(pwrfgs.InputError, match=said):
            pwrfgs.rasterize(**{**one, "pose": POSE, **change}, height=9, width=36)
    receiver = pwrfgs.Receiver(position=POSE.position, orientation=POSE.orientation)
    drawn = [pwrfgs.rasterize(**one, pose=pose, height=9, width=36) for pose in (POSE, receiver)]
    assert np.array_equal(*drawn)

//! Comparison with closed forms and scikit-learn 1.9.1.

use super::*;
use crate::splits::testing::line_of_samples;
use pwrfgs_core::kriging::{fit_spectra, solve, spatial_place};
use pwrfgs_core::{Pose, Sample, Spectra, rng};

const PLACES: [Place; 6] = [
    [0.0; 4],
    [0.5, 0.1, 0.2, 0.0],
    [0.9, 0.7, 0.1, 0.0],
    [0.2, 1.1, 0.6, 0.0],
    [1.3, 0.4, 0.9, 0.0],
    [0.7, 0.6, 0.5, 0.0],
];

fn close(a: f64, b: f64, by: f64) {
    assert!((a - b).abs() <= by, "{a} instead of {b}");
}

/// `GaussianProcessRegressor(ConstantKernel(1e7) + kernel, alpha=0.05, optimizer=None)`: a constant with a nearly flat
/// prior is an unknown mean. Its variance excludes the measurement noise, 0.05.
#[test]
fn kriging_predictions_match_scikit_learn() {
    let values = [1.0, 2.0, 4.0, 3.0, 7.0, 5.0];
    let known = [
        (CorrelationKind::Exponential, 3.794_441_619, 0.427_204_996),
        (CorrelationKind::Matern32, 3.806_622_089, 0.179_903_980),
        (CorrelationKind::SquaredExponential, 3.551_534_306, 0.093_223_336),
    ];
    for (kind, mean, variance) in known {
        let correlation = Correlation { kind, scales: [0.5, 0.8, 1.2, f64::INFINITY], noise: 0.05 };
        let places = PLACES.map(|place| correlation.scaled(place));
        let found = solve(&correlation, Mean::Unknown, &places, correlation.scaled([0.6, 0.5, 0.3, 0.0]));
        close(found.weights.iter().sum(), 1.0, 1e-12);
        close(found.weights.iter().zip(values).map(|(w, v)| w * v).sum(), mean, 1e-6);
        close(found.variance, variance, 1e-6);
    }
}

/// With one position the weight is 1 and the variance that of a difference; two at equal distance have weight 1/2 each.
#[test]
fn kriging_of_one_and_two_positions_has_closed_form() {
    let correlation = Correlation { kind: CorrelationKind::Exponential, scales: [1.0; 4], noise: 0.25 };
    let one = solve(&correlation, Mean::Unknown, &[[0.0; 4]], [0.7, 0.0, 0.0, 0.0]);
    assert_eq!(one.weights, [1.0]);
    close(one.variance, 2.0 * (1.0 + 0.25 - (-0.7f64).exp()), 1e-12);
    let two = solve(&correlation, Mean::Unknown, &[[-1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]], [0.0; 4]);
    close(two.weights[0], 0.5, 1e-12);
    close(two.variance, 1.25 + 0.5 * (1.25 + (-2.0f64).exp()) - 2.0 * (-1.0f64).exp(), 1e-12);
}

#[test]
fn kriging_without_noise_interpolates_and_accepts_coincident_positions() {
    for kind in CorrelationKind::ALL {
        let correlation = Correlation { kind, scales: [1.0; 4], noise: 1e-9 };
        let found = solve(&correlation, Mean::Unknown, &PLACES, PLACES[3]);
        close(found.weights[3], 1.0, 1e-4);
        let same = solve(&Correlation { noise: 1e-4, ..correlation }, Mean::Unknown, &[[1.0; 4]; 40], [2.0; 4]);
        assert!(same.weights.iter().all(|w| (w - 1.0 / 40.0).abs() < 1e-6) && same.variance > 0.0);
    }
}

/// Samples at random positions, each with 12 x 12 values drawn from a process with the given correlation.
fn drawn(correlation: &Correlation, count: usize) -> Dataset {
    let mut random = rng::stream(5, "process", 0);
    let samples: Vec<Sample> = (0..count as u32)
        .map(|id| Sample::new(id, [(); 3].map(|()| f64::from(rng::uniform(&mut random) as f32))))
        .collect();
    // Each value is drawn given those before it: exact, but slow.
    let mut pixels: Vec<Vec<f64>> = Vec::new();
    for i in 0..count {
        let places: Vec<Place> = samples[..i].iter().map(|s| correlation.scaled(spatial_place(s.position()))).collect();
        let solution = (i > 0).then(|| {
            solve(correlation, Mean::Unknown, &places, correlation.scaled(spatial_place(samples[i].position())))
        });
        let (weights, variance) = solution.map_or((vec![], 1.0 + correlation.noise), |s| (s.weights, s.variance));
        let pixel = |k: usize| {
            let mean: f64 = weights.iter().enumerate().map(|(j, w): (usize, &f64)| w * pixels[j][k]).sum();
            (mean, variance)
        };
        let picture = (0..144).map(pixel).collect::<Vec<_>>();
        let next = picture.into_iter().map(|(mean, v)| mean + v.sqrt() * rng::normal(&mut random) as f64).collect();
        pixels.push(next);
    }
    let flat: Vec<f32> = pixels.concat().into_iter().map(|v| v as f32).collect();
    Dataset::new("process", Pose::IDENTITY, vec![], samples, Spectra::float((12, 12), &flat).unwrap()).unwrap()
}

/// Cases of `validation` samples, each given its 24 nearest of `train`.
fn cases_of(data: &Dataset, train: &[usize], validation: &[usize], mean: Mean) -> HeldOutCases {
    let nearest = Nearest::new(train, 4, |i| link_place(data, i));
    let near = |i: usize| nearest.find(&link_place(data, i), 24).1.into_iter().map(|(_, j)| j).collect();
    let cases: Vec<(usize, Vec<usize>)> = validation.iter().map(|&i| (i, near(i))).collect();
    HeldOutCases::new(&cases, mean, |i| link_place(data, i), |_, i| data.image(i).pixels)
}

#[test]
fn likelihood_recovers_true_parameters() {
    for kind in [CorrelationKind::Exponential, CorrelationKind::SquaredExponential] {
        let truth = Correlation { kind, scales: [0.3, 0.3, 1.2, f64::INFINITY], noise: 0.1 };
        let data = drawn(&truth, 260);
        let (train, validation): (Vec<usize>, Vec<usize>) = (0..260).partition(|i| i % 4 != 0);
        let cases = cases_of(&data, &train, &validation, Mean::Unknown);
        let space = SearchSpace { kinds: &CorrelationKind::ALL, isotropic: false, time: false };
        let found = fit_correlation(&cases, space, &|| Ok(())).unwrap();
        println!("{found:?} for {truth:?}: {} {}", cases.log_likelihood(&found), cases.log_likelihood(&truth));
        assert_eq!(found.kind, kind);
        assert!(cases.log_likelihood(&found) > cases.log_likelihood(&truth) - 0.05);
        assert!((0.03..0.3).contains(&found.noise), "{found:?}");
        // Length scale and variance of an exponential are hard to separate; anisotropy is not.
        let stretch = found.scales[2] / found.scales[0];
        assert!((2.0..8.0).contains(&stretch), "{found:?}");
    }
}

#[test]
fn fit_to_all_spectra_recovers_true_parameters() {
    for kind in [CorrelationKind::Exponential, CorrelationKind::Matern32] {
        let truth = Correlation { kind, scales: [0.3, 0.3, 1.2, f64::INFINITY], noise: 0.1 };
        let data = drawn(&truth, 260);
        let place = |i| spatial_place(data.sample(i).position());
        let (found, variance) = fit_spectra(260, place, |i| data.image(i).pixels, false, &|| Ok(())).unwrap();
        println!("{found:?} and {variance} for {truth:?}");
        assert_eq!(found.kind, kind);
        assert!((0.05..0.2).contains(&found.noise), "{found:?}");
        let stretch = found.scales[2] / found.scales[0];
        assert!((2.5..6.0).contains(&stretch), "{found:?}");
        close(variance * found.noise, truth.noise, 0.03);
    }
}

/// Density of one sample given its neighbours, written out.
#[test]
fn likelihood_equals_density_of_predictions() {
    let truth = Correlation { kind: CorrelationKind::Matern32, scales: [0.5; 4], noise: 0.2 };
    let data = drawn(&truth, 12);
    for mean in [Mean::Unknown, Mean::Zero] {
        let cases = cases_of(&data, &(0..10).collect::<Vec<_>>(), &[10, 11], mean);
        let mut terms = Vec::new();
        for i in [10, 11] {
            let places: Vec<Place> = (0..10).map(|j| truth.scaled(link_place(&data, j))).collect();
            let Solution { weights, variance } = solve(&truth, mean, &places, truth.scaled(link_place(&data, i)));
            let mut error = 0.0;
            for k in 0..144 {
                let predicted: f64 = (0..10).map(|j| weights[j] * data.image(j).pixels[k] as f64).sum();
                error += (data.image(i).pixels[k] as f64 - predicted).powi(2);
            }
            terms.push((error, variance));
        }
        let strength = f64::midpoint(terms[0].0 / terms[0].1, terms[1].0 / terms[1].1);
        let expected = -0.5 * (2.0 * strength.ln() + terms[0].1.ln() + terms[1].1.ln());
        close(cases.log_likelihood(&truth), expected, 1e-4);
    }
}

#[test]
fn predictions_follow_from_parameters_in_note() {
    let truth = Correlation {
        kind: CorrelationKind::SquaredExponential,
        scales: [0.08, 0.3, 1.2, f64::INFINITY],
        noise: 0.001,
    };
    let data = drawn(&truth, 120);
    let all: Vec<usize> = (0..100).collect();
    let fitted = Kriging::default().fit(&data, FittingSet::train(&all)).unwrap();
    let note = fitted.note().unwrap();
    let words: Vec<&str> = note.split([' ', ',']).filter(|word| word.parse::<f64>().is_ok()).collect();
    for word in &words {
        let digits = word.trim_start_matches(['0', '.']).chars().filter(char::is_ascii_digit).count();
        assert!(digits >= 4, "{word} in: {note}");
    }
    let numbers: Vec<f64> = words.iter().map(|word| word.parse().unwrap()).collect();
    let [x, y, z, noise] = numbers[..] else { panic!("{note}") };
    let kind = CorrelationKind::ALL.into_iter().rev().find(|kind| note.contains(kind.words())).unwrap();
    let correlation = Correlation { kind, scales: [x, y, z, f64::INFINITY], noise };
    let again = Process::new(Trend::fit(&data, &[]), (correlation, 1.0), all, Kriging::default());
    for i in 100..120 {
        let [a, b] = [&*fitted, &again].map(|process: &dyn Predict| process.predict(data.query(i)).pixels);
        a.iter().zip(&b).for_each(|(a, b)| close(*a as f64, *b as f64, 5e-3));
    }
}

#[test]
fn kriging_accepts_few_and_equal_samples() {
    let data = line_of_samples(12);
    for count in [1, 2, 3, 12] {
        let all: Vec<usize> = (0..count).collect();
        let fitted = Kriging::default().fit(&data, FittingSet::train(&all)).unwrap();
        let picture = fitted.predict([3.5, 0.0, 0.0].into());
        assert!(picture.pixels.iter().all(|p| p.is_finite()), "{count}");
        assert!(fitted.note().unwrap().contains("length scales of"));
    }
    let same = Dataset::new(
        "same",
        Pose::IDENTITY,
        vec![],
        (0..30).map(|id| Sample::new(id, [1.0; 3])).collect(),
        Spectra::grey((2, 2), vec![51; 120]).unwrap(),
    );
    let same = same.unwrap();
    let fitted = Kriging::default().fit(&same, FittingSet::train(&(0..30).collect::<Vec<_>>())).unwrap();
    assert!(fitted.predict([1.0; 3].into()).pixels.iter().all(|p| (p - 0.2).abs() < 1e-5));
    assert!(Kriging::default().fit(&same, FittingSet::default()).is_err());
}

/// All samples are at nearly one position, and each value drifts slowly with the id.
#[test]
fn process_over_time_predicts_drift_that_space_alone_misses() {
    let mut random = rng::stream(4, "drift", 0);
    let mut near = || f64::from(rng::uniform(&mut random) as f32);
    let samples: Vec<Sample> = (0..200).map(|id| Sample::new(id, [near(), near(), 0.0])).collect();
    let drift = |id: usize, k: usize| (0.06 * id as f32 + k as f32).sin();
    let pixels: Vec<f32> = (0..200).flat_map(|id| (0..16).map(move |k| drift(id, k))).collect();
    let data =
        Dataset::new("drift", Pose::IDENTITY, vec![], samples, Spectra::float((4, 4), &pixels).unwrap()).unwrap();
    let (test, train): (Vec<usize>, Vec<usize>) = (0..200).partition(|i| i % 5 == 2);
    let error = |time: bool| {
        let fitted = Kriging { time, ..Kriging::default() }.fit(&data, FittingSet::train(&train)).unwrap();
        assert_eq!(fitted.is_oracle(), time);
        assert_eq!(fitted.note().unwrap().contains("a time scale of"), time);
        let without_id = fitted.predict(Query::from([0.5, 0.5, 0.0]));
        assert!(without_id.pixels.iter().all(|p| p.is_finite()));
        let of = |&i: &usize| {
            let (found, truth) = (fitted.predict(data.query(i)), data.image(i));
            found.pixels.iter().zip(&truth.pixels).map(|(f, t)| (*f as f64 - *t as f64).abs()).sum::<f64>() / 16.0
        };
        test.iter().map(of).sum::<f64>() / test.len() as f64
    };
    let (space, both) = (error(false), error(true));
    assert!(both < 0.05 && space > 0.3, "{both} and {space}");
}

/// The parameters stay, so the process equals one of the other samples; it is less certain where samples are missing.
#[test]
fn kriging_without_samples_keeps_its_parameters() {
    let correlation = Correlation { kind: CorrelationKind::Matern32, scales: [0.4; 4], noise: 0.1 };
    let data = drawn(&correlation, 60);
    let [all, left_out, others] = [0..50, 0..20, 20..50].map(Iterator::collect::<Vec<usize>>);
    let fitted = Kriging::default().fit(&data, FittingSet::train(&all)).unwrap();
    let without = fitted.without(&left_out).unwrap();
    assert!(without.without(&others).is_none(), "no sample is left");
    let (mut with_them, mut without_them) = (0.0, 0.0);
    for &i in &left_out {
        with_them += fitted.deviation(data.query(i)).unwrap();
        without_them += without.deviation(data.query(i)).unwrap();
        assert_ne!(fitted.predict(data.query(i)), without.predict(data.query(i)));
    }
    assert!(without_them > with_them, "{without_them} and {with_them}");
    let far = Query::from([1e3, 0.0, 0.0]);
    let [a, b] = [&fitted, &without].map(|process| process.deviation(far).unwrap());
    close(a / b, 1.0, 0.2);
    let alone = Kriging::default().fit(&data, FittingSet::train(&[0])).unwrap();
    assert_eq!(alone.deviation(far), None, "nothing is known of errors");
}

//! Localisation in a hall with four receivers, whose powers follow a path-loss model with noise.

use crate::{FingerprintFeatures, Locator, NearestFingerprints, mean_and_median};
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Channels, Spectra, rng};
use pwrfgs_core::{Dataset, Elevation, FittingSet, Image, Observations, Pose, Predict, Query, Real, Receiver, Sample};
use std::sync::atomic::{AtomicUsize, Ordering};

const RECEIVERS: [[f64; 3]; 4] = [[0.0, 0.0, 3.0], [10.0, 0.0, 3.0], [0.0, 6.0, 3.0], [10.0, 6.0, 3.0]];

fn dbm(tx: [f64; 3], receiver: usize) -> f64 {
    -40.0 - 30.0 * distance(tx, RECEIVERS[receiver]).log10()
}

/// The path-loss model, with its derivative.
struct PathLoss;

impl Predict for PathLoss {
    fn predict(&self, query: Query<'_>) -> Image {
        Image { width: 1, height: 1, pixels: vec![dbm(query.position(), query.receiver) as Real] }
    }

    fn predict_vjp(&self, query: Query<'_>, cotangent: &dyn Fn(&Image) -> Vec<Real>) -> Option<(Image, [f64; 3])> {
        let image = self.predict(query);
        let (d, at) = (f64::from(cotangent(&image)[0] as f32), RECEIVERS[query.receiver]);
        let square = distance(query.position(), at).powi(2);
        let slope = -30.0 / std::f64::consts::LN_10 / square;
        Some((image, [0, 1, 2].map(|k| d * slope * (query.position()[k] - at[k]))))
    }
}

/// Returns 300 training positions 0.4 to 0.5 m apart, then 120 validation and 120 test positions at random.
fn hall() -> (Dataset, [Vec<usize>; 3]) {
    hall_of(240)
}

/// Returns the hall with `further` positions at random after the training positions; the first 120 are for validation.
fn hall_of(further: u32) -> (Dataset, [Vec<usize>; 3]) {
    let random = &mut rng::stream(0, "hall", 0);
    let grid = (0..300).map(|k| [0.25 + 0.5 * f64::from(k % 20), 0.2 + 0.4 * f64::from(k / 20), 1.0]);
    let mut positions: Vec<[f64; 3]> = grid.collect();
    let mut uniform = |size: f64| size * f64::from(rng::uniform(random) as f32);
    positions.extend((0..further).map(|_| [uniform(10.0), uniform(6.0), 1.0]));
    let samples = positions
        .iter()
        .enumerate()
        .flat_map(|(k, tx)| (0..4).map(move |receiver| Sample { receiver, ..Sample::new(k as u32, *tx) }));
    let samples: Vec<Sample> = samples.collect();
    let noise = &mut rng::stream(1, "noise", 0);
    let powers: Vec<Real> =
        samples.iter().map(|s| dbm(s.position(), s.receiver) as Real + 0.5 * rng::normal(noise)).collect();
    let receivers = RECEIVERS.iter().enumerate();
    let receivers = receivers.map(|(k, at)| Receiver::new(format!("r{k}"), Pose { position: *at, ..Pose::IDENTITY }));
    let data =
        Dataset::of_links("hall", receivers.collect::<Vec<_>>(), vec![], &samples, Observations::from(powers)).unwrap();
    (data, [(0..1200).collect(), (1200..1680).collect(), (1680..2160).collect()])
}

#[test]
fn model_locates_better_than_nearest_fingerprints_and_regions_hold_nine_of_ten() {
    let (data, [train, validation, test]) = hall();
    let links = FittingSet { train: &train, validation: &validation, ..FittingSet::default() };
    let locator = Locator::fit(&data, links, &PathLoss, &[0.0, 0.5, 1.0], &|_, _| {}).unwrap();
    assert!(locator.choice.share > 0.0, "the exact law is better than noisy measurements: {:?}", locator.choice);
    let transmitters = data.locations_of(&test);
    let observations = locator.observations(&data, &transmitters);
    let truth = |k: usize| data.locations[transmitters[k]].position();
    let located: Vec<_> = observations.iter().map(|features| locator.locate(features)).collect();
    let errors = located.iter().enumerate().map(|(k, estimate)| distance(estimate.position, truth(k))).collect();
    let nearest = NearestFingerprints::fit(&data, links, locator.features(), locator.floor());
    let baseline =
        observations.iter().enumerate().map(|(k, features)| distance(nearest.locate(features), truth(k))).collect();
    let ([mean, median], [worse, _]) = (mean_and_median(errors), mean_and_median(baseline));
    assert!(mean < worse && median < 0.5, "{mean} m and {median} m, nearest fingerprints {worse} m");
    let held = located.iter().enumerate().filter(|(k, estimate)| estimate.holds(truth(*k)) == Some(true)).count();
    assert!((96..=118).contains(&held), "{held} of 120 regions hold the true position");
    let outline = located[0].region.as_ref().unwrap().outlines();
    assert!(!outline.is_empty());
}

#[test]
fn at_most_a_thousand_validation_samples_choose() {
    let (data, [train, ..]) = hall_of(1_300);
    let all: Vec<usize> = (1_200..6_400).collect();
    let fit = |validation: &[usize], most: &AtomicUsize| {
        let links = FittingSet { train: &train, validation, ..FittingSet::default() };
        let progress = |done: usize, total: usize| {
            assert!(done <= total);
            most.fetch_max(1_000 * done / total, Ordering::Relaxed);
        };
        Locator::fit(&data, links, &PathLoss, &[1.0], &progress).unwrap()
    };
    let most = AtomicUsize::default();
    let (thinned, few) = (fit(&all, &most), fit(&all[..1_200], &most));
    assert_eq!((thinned.validation, few.validation, most.into_inner()), (1_000, 300, 1_000));
    assert_eq!(thinned.choice.sharpness, few.choice.sharpness);
    let held = thinned.observations(&data, &(300..1_600).collect::<Vec<_>>());
    let held = held
        .iter()
        .enumerate()
        .filter(|(k, observation)| thinned.locate(observation).holds(data.locations[300 + k].position()) == Some(true));
    let share = held.count() as f64 / 1_300.0;
    assert!((0.88..=0.92).contains(&share), "{share}");
}

#[test]
fn unknown_powers_are_ignored_and_invalid_boxes_refused() {
    let (data, [train, validation, _]) = hall();
    let links = FittingSet { train: &train, validation: &validation, ..FittingSet::default() };
    let locator = Locator::fit(&data, links, &PathLoss, &[1.0], &|_, _| {}).unwrap();
    let whole = locator.observations(&data, &[305]).remove(0);
    let some = [whole[0], f32::NAN, whole[2], whole[3]];
    let apart = distance(locator.locate(&whole).position, locator.locate(&some).position);
    assert!(apart < 1.5, "three receivers are enough: {apart} m apart");
    let weak = |dbm: f32| locator.locate(&[whole[0], dbm, whole[2], whole[3]]).position;
    assert_eq!(weak(locator.floor()), weak(-200.0), "powers below the floor count as the floor");
    let without_model = Locator::fit(&data, links, &PathLoss, &[0.0], &|_, _| {}).unwrap();
    let (first, position) = (without_model.observations(&data, &[0]).remove(0), data.locations[0].position());
    assert_eq!(without_model.locate(&first).misfit, 0.0, "a training sample has its own fingerprint");
    assert!(without_model.locate_without(&first, Some(position)).misfit > 0.0);
    let nothing = locator.locate(&[f32::NAN; 4]);
    assert!(nothing.position.iter().all(|v| v.is_finite()) && nothing.misfit.is_infinite());
    assert!(locator.within(|_| false).is_err());
}

#[test]
fn derivative_of_features_agrees_with_central_differences() {
    let mut random = rng::stream(0, "features", 0);
    let mut values = |count: usize| (0..count).map(|_| 0.2 + rng::uniform(&mut random)).collect::<Vec<Real>>();
    let samples = |count: u32| (1..=count).map(|id| Sample::new(id, [f64::from(id), 0.0, 1.5])).collect::<Vec<_>>();
    let spectra = Spectra::grey((140, 60), vec![90; 2 * 140 * 60]).unwrap();
    let spectra = Dataset::new("sky", Pose::IDENTITY, vec![], samples(2), spectra).unwrap();
    let gains = values(2 * 2 * 3 * 2).as_chunks::<2>().0.to_vec();
    let channels = Channels { antennas: 2, frequencies_hz: vec![1e9, 2e9, 3e9], gains };
    let receivers = vec![Receiver { antennas: vec![[0.0; 3], [0.1, 0.0, 0.0]], ..Receiver::new("r", Pose::IDENTITY) }];
    let channels = Dataset::of_links("waves", receivers, vec![], &samples(2), channels.into()).unwrap();
    assert_eq!(spectra.elevation, Elevation::UPPER);
    for data in [&spectra, &channels] {
        let features = FingerprintFeatures::new(data, &[0, 1]);
        let numbers = data.width * data.height;
        let image = |pixels: Vec<Real>| Image { width: data.width, height: data.height, pixels };
        let (pixels, d) = (values(numbers), values(features.count()));
        let d: Vec<f32> = d.iter().map(|d| *d as f32).collect();
        let gradient = features.vjp(&image(pixels.clone()), &d);
        let along = values(numbers);
        let sum = |h: Real| {
            let moved = pixels.iter().zip(&along).map(|(p, a)| p + h * a).collect();
            features.extract(&image(moved)).iter().zip(&d).map(|(f, d)| f64::from(f * d)).sum::<f64>()
        };
        let difference = (sum(0.02) - sum(-0.02)) / 0.04;
        let expected: f64 = gradient.iter().zip(&along).map(|(f, a)| (f * a) as f64).sum();
        assert!((difference - expected).abs() < 2e-2 * expected.abs(), "{difference} and {expected}");
    }
}

/// One receiver at the corner of a hall, and two areas that are equally far from it: powers cannot distinguish them.
#[test]
fn estimate_between_two_areas_is_in_one_of_them() {
    let noise = &mut rng::stream(2, "areas", 0);
    let position = |k: u32| {
        let cell = k * 37 % 200;
        let [along, across] = [f64::from(cell % 20) * 0.1, 14.0 + f64::from(cell / 20) * 0.2];
        if cell.is_multiple_of(2) { [along, across, 1.0] } else { [across, along, 1.0] }
    };
    let samples: Vec<Sample> = (0..200).map(|k| Sample::new(k, position(k))).collect();
    let powers: Vec<Real> = samples.iter().map(|s| dbm(s.position(), 0) as Real + 0.1 * rng::normal(noise)).collect();
    let receiver = Receiver::new("r", Pose { position: RECEIVERS[0], ..Pose::IDENTITY });
    let data = Dataset::of_links("areas", vec![receiver], vec![], &samples, Observations::from(powers)).unwrap();
    let (train, validation): (Vec<usize>, Vec<usize>) = ((0..140).collect(), (140..200).collect());
    let links = FittingSet { train: &train, validation: &validation, ..FittingSet::default() };
    let locator = Locator::fit(&data, links, &PathLoss, &[0.0, 1.0], &|_, _| {}).unwrap();
    assert!(locator.validates_between_training());
    let mut several = 0;
    for observation in locator.observations(&data, &(140..200).collect::<Vec<_>>()) {
        let located = locator.locate(&observation);
        let [x, y, _] = located.position;
        assert_eq!(located.holds(located.position), Some(true), "{x} {y}");
        let has_several = located.region.unwrap().part_count() >= 2;
        assert!(!has_several || (x.max(y) > 13.5 && x.min(y) < 2.5), "{x} {y}");
        several += usize::from(has_several);
    }
    assert!(several > 30, "{several} of 60 regions have a part in each area");
}

/// Constant model; without samples, the path-loss model.
struct FromSamples;

impl Predict for FromSamples {
    fn predict(&self, _: Query<'_>) -> Image {
        Image { width: 1, height: 1, pixels: vec![-50.0] }
    }

    fn without(&self, links: &[usize]) -> Option<Box<dyn Predict + '_>> {
        assert_eq!(links, (1200..1680).collect::<Vec<_>>());
        Some(Box::new(PathLoss))
    }
}

#[test]
fn model_of_samples_is_used_without_validation_samples() {
    let (data, [train, validation, _]) = hall();
    let links = FittingSet { train: &train, validation: &validation, ..FittingSet::default() };
    let [without, path_loss] = [&FromSamples as &dyn Predict, &PathLoss].map(|model| {
        let locator = Locator::fit(&data, links, model, &[1.0], &|_, _| {}).unwrap();
        locator.locate(&locator.observations(&data, &[305])[0]).position
    });
    assert_eq!(without, path_loss);
}

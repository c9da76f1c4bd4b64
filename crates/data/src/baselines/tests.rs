//! Tests of the mean and of nearest neighbours.

use super::*;
use crate::splits::testing::{line_of_samples, samples_at};
use pwrfgs_core::neighbours::Nearest;
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Pose, Sample, SiteSize, Spectra, block_of, rng, ssim};

fn predict(baseline: &dyn Baseline, data: &Dataset, train: &[usize], x: f64) -> f64 {
    let image = baseline.fit(data, FittingSet::train(train)).unwrap().predict([x, 0.0, 0.0].into());
    assert_eq!((image.width, image.height, image.pixels.len()), (1, 1, 1));
    image.pixels[0] as f64 * 255.0
}

fn k_nearest(k: usize) -> NearestNeighbours {
    NearestNeighbours { k: k.into() }
}

fn close(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-4
}

#[test]
fn mean_spectrum_ignores_transmitter() {
    let data = line_of_samples(4); // values 0, 1, 2, 3
    assert!(close(predict(&MeanSpectrum {}, &data, &[1, 3], 100.0), 2.0));
}

#[test]
fn nearest_neighbours_are_weighted_by_inverse_distance() {
    let data = line_of_samples(10);
    assert!(close(predict(&k_nearest(1), &data, &[0, 4, 9], 5.0), 4.0));
    assert!(close(predict(&k_nearest(2), &data, &[0, 4, 9], 6.0), (4.0 / 2.0 + 9.0 / 3.0) / (1.0 / 2.0 + 1.0 / 3.0)));
    // More neighbours than samples: all of them.
    let all = predict(&k_nearest(99), &data, &[4, 9], 6.0);
    assert!(close(all, (4.0 / 2.0 + 9.0 / 3.0) / (1.0 / 2.0 + 1.0 / 3.0)));
}

#[test]
fn nearest_neighbour_at_sample_returns_its_observation() {
    let data = samples_at(&[[0.0; 3], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]);
    assert!(close(predict(&k_nearest(1), &data, &[0, 1, 2, 3], 1.0), 1.5));
    assert!(close(predict(&k_nearest(3), &data, &[0, 1, 3], 1.0), 1.0));
}

#[test]
fn ties_select_lower_index() {
    let data = line_of_samples(3);
    assert!(close(predict(&k_nearest(1), &data, &[2, 0], 1.0), 0.0));
}

#[test]
fn finds_nearest_of_thousands_of_samples() {
    let places: Vec<[f64; 3]> = (0..5000).map(|i| [f64::from(i * 7919 % 5000), f64::from(i % 3), 0.0]).collect();
    let data = samples_at(&places);
    for k in [1, 3, 700, 5000] {
        let nearest = Nearest::new(&(0..5000).collect::<Vec<_>>(), 3, |i| data.sample(i).position());
        let tx = [2500.25, 1.0, 0.0];
        let mut all: Vec<(f64, usize)> =
            places.iter().enumerate().map(|(i, place)| (distance(*place, tx), i)).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        assert_eq!(nearest.find(&tx, k), (vec![], all[..k].to_vec()), "{k}");
    }
    let same = samples_at(&vec![[1.0; 3]; 3000]);
    let nearest = Nearest::new(&(0..3000).collect::<Vec<_>>(), 3, |i| same.sample(i).position());
    let (exact, near) = nearest.find(&[1.0; 3], 2);
    assert_eq!((exact.len(), near), (3000, vec![(0.0, 0), (0.0, 1)]), "all that stand there");
}

/// Spectra that change from one pattern to another along a line, with independent noise.
fn noisy_line(noise: f64) -> Dataset {
    let mut random = rng::stream(2, "noise", 0);
    let samples: Vec<Sample> = (0..200).map(|id| Sample::new(id, [f64::from(id), 0.0, 0.0])).collect();
    let mut pixels = Vec::new();
    for sample in &samples {
        let part = sample.position()[0] / 200.0;
        pixels.extend((0..144).map(|k| {
            let [one, other] = [0.7, 1.9].map(|speed| 0.5 + 0.4 * (speed * f64::from(k)).sin());
            (one * (1.0 - part) + other * part + noise * rng::normal(&mut random) as f64) as f32
        }));
    }
    Dataset::new("line", Pose::IDENTITY, vec![], samples, Spectra::float((12, 12), &pixels).unwrap()).unwrap()
}

#[test]
fn auto_selects_more_neighbours_for_noisy_spectra() {
    let (validation, train): (Vec<usize>, Vec<usize>) = (0..200).partition(|i| i % 8 == 3);
    let chosen = |noise, known: FittingSet<'_>| {
        let data = noisy_line(noise);
        let note = NearestNeighbours { k: Neighbours::Auto }.fit(&data, known).unwrap().note().unwrap();
        let k = note.strip_prefix("k-NN uses k = ").and_then(|rest| rest.split(',').next()).unwrap();
        k.parse::<usize>().unwrap()
    };
    for known in
        [FittingSet { train: &train, validation: &validation, ..FittingSet::default() }, FittingSet::train(&train)]
    {
        let [clean, noisy] = [0.0, 0.2].map(|noise| chosen(noise, known));
        assert!(clean <= 12 && noisy >= 20, "{clean} and {noisy}");
    }
}

/// The automatic choice agrees with scoring every k separately, from the samples of other blocks.
#[test]
fn auto_selects_best_k() {
    let data = noisy_line(0.1);
    let place = |i: usize| data.sample(i).position();
    let edge = SiteSize::new((0..200).map(place)).block_edge();
    let score = |k: usize| -> f64 {
        let of = |i: usize| {
            let others: Vec<usize> =
                (0..200).filter(|j| block_of(place(*j), edge) != block_of(place(i), edge)).collect();
            let fitted = k_nearest(k).fit(&data, FittingSet::train(&others)).unwrap();
            ssim::evaluation(&fitted.predict(data.query(i)).clamped(), &data.image(i))
        };
        (0..200).map(of).sum()
    };
    let best =
        [1, 2, 3, 5, 8, 12, 20, 30, 40, 60, 80, 120, 160].into_iter().max_by(|a, b| score(*a).total_cmp(&score(*b)));
    let (validation, train): (Vec<usize>, Vec<usize>) = (0..200).partition(|i| i % 8 == 3);
    let known = FittingSet { train: &train, validation: &validation, ..FittingSet::default() };
    let fitted = NearestNeighbours { k: Neighbours::Auto }.fit(&data, known).unwrap();
    assert_eq!(fitted.note().unwrap(), format!("k-NN uses k = {}, best on held-out blocks", best.unwrap()));
    // The prediction uses both training and validation samples.
    let known = FittingSet { train: &[0], validation: &[1], ..FittingSet::default() };
    let fitted = NearestNeighbours { k: Neighbours::Auto }.fit(&data, known).unwrap();
    assert_eq!(fitted.predict([1.0, 0.0, 0.0].into()), data.image(1));
}

#[test]
fn parses_k_as_number_or_auto() {
    let parse = pwrfgs_core::Plugin::<dyn Baseline>::parse;
    for text in ["NearestNeighbours(k:Auto)", "NearestNeighbours(k:12)", "NearestNeighbours(k:1_000)"] {
        let name = parse(text).unwrap().name();
        assert!(["k-NN", "12-NN", "1000-NN"].contains(&name.as_str()), "{name}");
    }
    for text in ["NearestNeighbours(k: Many)", "NearestNeighbours(k: 2.5)", "NearestNeighbours(k: -1)"] {
        let shown = parse(text).unwrap_err();
        assert!(shown.contains("give a number of neighbours, such as 3, or Auto"), "{shown}");
    }
}

#[test]
fn rejects_empty_training_set() {
    let data = line_of_samples(3);
    for baseline in [&MeanSpectrum {} as &dyn Baseline, &NearestNeighbours::default()] {
        let message = baseline.fit(&data, FittingSet::default()).err().unwrap().to_string();
        assert_eq!(message, "a baseline needs at least one training sample; change the split");
    }
}

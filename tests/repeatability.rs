//! Repeatability of measurements at one place, for measured and synthetic spectra.

use pwrfgs::experiment::repeatability::{PairSimilarity, ZeroDistanceEstimate};
use pwrfgs::experiment::{Repeatability, measure_repeatability};
use pwrfgs_core::testing::shared;
use pwrfgs_core::{DataSource, Dataset, Metric, Plugin, Pose, Sample, Spectra, rng};
use pwrfgs_data::Nerf2Spectrum;
use std::path::Path;
use std::sync::atomic::AtomicBool;

fn measure(data: &Dataset, metrics: &[&str]) -> Repeatability {
    let metrics: Vec<_> = metrics.iter().map(|text| Plugin::<dyn Metric>::parse(text).unwrap()).collect();
    measure_repeatability(data, &metrics, &AtomicBool::new(false)).unwrap()
}

fn at_zero<'a>(similarity: &'a PairSimilarity, key: &str) -> &'a Result<ZeroDistanceEstimate, String> {
    &similarity.metrics.iter().find(|m| m.key == key).unwrap().at_zero
}

/// The table of pairs measured elsewhere (Python, scikit-image): SSIM near in time, and far apart.
#[test]
fn measured_spectra_repeat_only_near_in_time() {
    let Some(root) = shared("data/s23") else { return };
    let data = Nerf2Spectrum { root, ..Default::default() }.load(Path::new("."), &|_, _| {}).unwrap();
    let found = measure(&data, &["Ssim()", "GaussianCount()"]);
    // Range in mm, mean and median near in time, the same far apart.
    let known = [
        ([3.0, 5.0], [0.941, 0.978], Some([0.710, 0.747])),
        ([5.0, 7.0], [0.947, 0.982], Some([0.732, 0.735])),
        ([7.0, 10.0], [0.909, 0.973], Some([0.697, 0.731])),
        ([10.0, 20.0], [0.886, 0.933], Some([0.696, 0.742])),
    ];
    let mut seen = 0;
    for (similarity, of) in [(&found.near, 0), (&found.far, 1)] {
        assert_eq!(similarity.metrics.len(), 1, "a metric of the model says nothing of pairs");
        for bin in &similarity.metrics[0].bins {
            println!("{:.1} to {:.1} mm: {bin:?}", bin.from_m * 1e3, bin.to_m * 1e3);
            let same = |mm: &[f64; 2]| mm[0] == bin.from_m * 1e3 && mm[1] == bin.to_m * 1e3;
            if let Some((_, near, far)) = known.iter().find(|known| same(&known.0)) {
                let [mean, median] = if of == 0 { *near } else { far.unwrap() };
                // At most a hundred pairs of each range are looked at here, there were all of them: a standard error of some
                // 0.02, and other pairs in double precision.
                assert!((bin.mean - mean).abs() < 0.05 && (bin.median - median).abs() < 0.05, "{bin:?}");
                seen += 1;
            }
        }
    }
    assert_eq!(seen, 8);
    let [near, far] = [&found.near, &found.far].map(|similarity| at_zero(similarity, "ssim").clone().unwrap());
    println!("at zero: near {near:.3?}, far {far:.3?}, unrelated {:.3}", found.far.metrics[0].unrelated);
    assert!(near.interval[0] > 0.88 && near.summary.mean > 0.94, "{near:?}");
    assert!((0.69..0.76).contains(&far.summary.mean) && far.interval[1] < near.interval[0], "{far:?}");
}

/// A transmitter goes over one line in steps of 4 mm, `turns` times; the spectrum is a smooth function of its place, plus
/// what `drift` makes of the time.
fn line(turns: u32, drift: impl Fn(u32) -> f32) -> Dataset {
    let place = |id: u32| f64::from(id % 200) * 0.004;
    let samples: Vec<Sample> = (0..200 * turns).map(|id| Sample::new(id, [place(id), 1.0, 1.0])).collect();
    let pixel = |sample: &Sample, k: usize| {
        let smooth = 0.5 + 0.2 * (3.0 * sample.position()[0] + 0.7 * k as f64).sin() as f32;
        smooth + drift(sample.id)
    };
    let pixels: Vec<f32> = samples.iter().flat_map(|sample| (0..64).map(move |k| pixel(sample, k))).collect();
    Dataset::new("line", Pose::IDENTITY, vec![], samples, Spectra::float((8, 8), &pixels).unwrap()).unwrap()
}

#[test]
fn spectra_without_noise_repeat() {
    let found = measure(&line(5, |_| 0.0), &["Ssim()", "L1()"]);
    for similarity in [&found.near, &found.far] {
        let (ssim, l1) = (at_zero(similarity, "ssim").clone().unwrap(), at_zero(similarity, "l1").clone().unwrap());
        assert!(ssim.summary.mean > 0.999 && ssim.interval[0] > 0.999, "{ssim:?}");
        assert!(l1.summary.mean < 1e-3 && l1.interval[1] < 1e-3, "{l1:?}");
    }
}

/// Two values of the level in turn, at random: |difference| is 0 or 0.1, so 0.05 in the mean, whatever the time.
#[test]
fn finds_noise_of_independent_spectra_at_any_lag() {
    let noise = |id| if rng::uniform(&mut rng::stream(1, "noise", u64::from(id))) < 0.5 { 0.1 } else { 0.0 };
    let found = measure(&line(5, noise), &["L1()"]);
    for similarity in [&found.near, &found.far] {
        let l1 = at_zero(similarity, "l1").clone().unwrap();
        assert!(l1.interval[0] < 0.05 && 0.05 < l1.interval[1] && (l1.summary.mean - 0.05).abs() < 0.015, "{l1:?}");
    }
}

/// Every pass has a level of its own, so near in time spectra repeat, and at another time they differ.
#[test]
fn slow_changes_separate_near_and_far_pairs() {
    let found = measure(&line(6, |id| 0.02 * (id / 200) as f32), &["L1()"]);
    let [near, far] = [&found.near, &found.far].map(|similarity| at_zero(similarity, "l1").clone().unwrap());
    assert!(near.summary.mean < 0.005, "{near:?}");
    // Mean of |a - b| over pairs of different passes of six: 7/3 of a fiftieth.
    assert!((far.summary.mean - 0.14 / 3.0).abs() < 0.008, "{far:?}");
}

#[test]
fn undetermined_ceiling_has_a_reason() {
    let samples: Vec<Sample> = (0..60).map(|id| Sample::new(id, [f64::from(id * 37 % 60), 0.0, 0.0])).collect();
    let data = Dataset::new("far", Pose::IDENTITY, vec![], samples, Spectra::grey((8, 8), vec![9; 60 * 64]).unwrap());
    let found = measure(&data.unwrap(), &["Ssim()"]);
    let why = at_zero(&found.far, "ssim").clone().unwrap_err();
    assert_eq!(
        why,
        "0 pairs of samples far apart in time (more than 30 ids) are within 2 cm of each other; at least 20 are needed"
    );
    assert!(at_zero(&found.near, "ssim").is_err());
    let one = Spectra::grey((8, 8), vec![9; 64]).unwrap();
    let alone = Dataset::new("one", Pose::IDENTITY, vec![], vec![Sample::new(1, [0.0; 3])], one).unwrap();
    assert!(at_zero(&measure(&alone, &["Ssim()"]).near, "ssim").is_err());
}

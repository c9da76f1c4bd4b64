//! Scores of the baselines on measured spectra against NumPy and scikit-image with the same rules.

use pwrfgs_core::testing::shared;
use pwrfgs_core::{Baseline, DataSource, Dataset, Evaluation, Image, ImagePlane, Metric, Split, Values, rng};
use pwrfgs_data::{MeanSpectrum, NearestNeighbours, Nerf2Spectrum, Official};
use pwrfgs_metrics::{RateRatio, Ssim};
use std::path::Path;

fn scores(metric: &dyn Metric, predictions: &[Image], truths: &[Image], data: &Dataset) -> Vec<f64> {
    let plane = ImagePlane { wraps: true, ..ImagePlane::plain(data.width, data.height) };
    let evaluation = Evaluation { predictions, truths, ..Evaluation::of(data, &plane) };
    match metric.evaluate(&evaluation).expect("pictures of one size").remove(0).values {
        Values::PerSample(values) => values,
        other => panic!("not one value a sample: {other:?}"),
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    f64::midpoint(sorted[(sorted.len() - 1) / 2], sorted[sorted.len() / 2])
}

#[test]
fn baselines_reach_known_scores_on_measured_spectra() {
    let Some(root) = shared("data/s23") else { return };
    let data = Nerf2Spectrum { root, ..Default::default() }.load(Path::new("."), &|_, _| {}).unwrap();
    let partition = Official { validation: 0.0 }.split(&data, &mut rng::stream(0, "split", 0)).unwrap();
    let truths: Vec<Image> = partition.test.iter().map(|&i| data.image(i)).collect();
    let known: [(&dyn Baseline, [f64; 3]); 4] = [
        (&MeanSpectrum {}, [0.6334, 0.6627, 0.9160]),
        (&NearestNeighbours { k: 1.into() }, [0.8753, 0.9547, 0.9813]),
        (&NearestNeighbours { k: 3.into() }, [0.8858, 0.9459, 0.9836]),
        (&NearestNeighbours { k: 5.into() }, [0.8824, 0.9353, 0.9839]),
    ];
    for (baseline, expected) in known {
        let fitted = baseline.fit(&data, partition.known()).unwrap();
        let predictions: Vec<Image> = partition.test.iter().map(|&i| fitted.predict(data.query(i))).collect();
        let ssim = scores(&Ssim {}, &predictions, &truths, &data);
        let eta = scores(&RateRatio { snr_db: 0.0 }, &predictions, &truths, &data);
        let found = [mean(&ssim), median(&ssim), mean(&eta)];
        println!("{}: SSIM mean, median, eta mean: {found:.5?}", baseline.name());
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() <= 0.5e-4 + 1e-6, "{}: {found} instead of {expected}", baseline.name());
        }
    }
}

//! One spectrum of 360 x 90 pixels from the channel of 4 x 4 antennas, on one thread.
//!
//! `cargo bench -p pwrfgs-raytrace --bench spectrum`

use criterion::Criterion;
use pwrfgs_raytrace::Complex;
use pwrfgs_raytrace::array::Array;
use pwrfgs_raytrace::spectrum::{Beamformer, SpectrumKind};
use std::hint::black_box;

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let beamformer = Beamformer::new(&Array::default(), 360, 90);
    let channel: Vec<Complex> = (0..16).map(|k| Complex::cis(1.7 * f64::from(k * k))).collect();
    let mut group = criterion.benchmark_group("spectrum");
    group.bench_function("amplitude", |b| b.iter(|| beamformer.amplitude(black_box(&channel))));
    group.bench_function("picture", |b| {
        b.iter(|| beamformer.spectrum(black_box(&channel), SpectrumKind::Amplitude));
    });
    group.finish();
    criterion.final_summary();
}

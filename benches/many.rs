//! 10,000 positions in one call, for comparison with the same call from Python.
//!
//! `PWRFGS_MODEL=runs/x/model.safetensors cargo bench -p pwrfgs --bench many` prints the seconds it took;
//! `python/benches/predict.py` runs it and Python in turn.

#![allow(clippy::print_stdout)] // what it prints is what it is for

use pwrfgs::core::Query;
use pwrfgs::model::file;
use std::path::Path;
use std::time::Instant;

fn main() {
    let model = std::env::var("PWRFGS_MODEL").expect("PWRFGS_MODEL, the path of a model");
    let model = file::read_ensemble(Path::new(&model)).expect("a model");
    let ready = model.prepare();
    let place = |k: u32| Query::from([0.05 * f64::from(k % 100), 0.05 * f64::from(k / 100), 1.5]);
    let queries: Vec<Query<'_>> = (0..10_000).map(place).collect();
    std::hint::black_box(ready.predict_many(&queries[..64])); // threads and buffers are there
    let begun = Instant::now();
    let images = std::hint::black_box(ready.predict_many(&queries));
    println!("{:.4}", begun.elapsed().as_secs_f64());
    drop(images);
}

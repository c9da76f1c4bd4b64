//! Every stage of a prediction and of a training step, at the three model sizes of the paper.
//!
//! `RAYON_NUM_THREADS=2 cargo bench -p pwrfgs --bench pipeline` takes about ten minutes and ends with the table of
//! targets; a word after `--` selects, as in `-- predict`. `PWRFGS_MODEL=runs/x/model.safetensors` replaces the small
//! trained model by one of yours (still called 157). What the numbers were, and against what they are to be read, is in
//! `docs/lab/performance.md`.

mod scene;

use criterion::measurement::WallTime;
use criterion::{BatchSize, BenchmarkGroup, BenchmarkId, Criterion};
use pwrfgs::core::{
    DeformationInputs, DeformationVjp, ImagePlane, MeasurementSetup, Origin, Pose, Query, Receiver, RenderVjp, Task,
    rng,
};
use pwrfgs::methods::{Calibration, Readout, Splatting};
use pwrfgs::model::{Ensemble, Model, Stages};
use pwrfgs::networks::Outputs;
use pwrfgs::prelude::*;
use scene::{SIZES, TX, on_array, seeded_cloud, trained, untrained, waves, wrfgs};
use std::cell::OnceCell;
use std::time::{Duration, Instant, SystemTime};

/// Channels that one transmitter needs.
const CHANNELS: usize = 2;

fn main() {
    let start = SystemTime::now();
    let mut criterion = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
        .configure_from_args();
    network(&mut criterion, "network", Outputs::All);
    network(&mut criterion, "network signals", Outputs::Signals);
    stages(&mut criterion);
    step(&mut criterion);
    predict(&mut criterion);
    scale(&mut criterion);
    links(&mut criterion);
    criterion.final_summary();
    scene::table::print(SIZES, start);
}

/// What all 21 receivers of a site hear of one transmitter, through a network as `pipelines/ble.ron` has it.
fn links(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("links");
    for sky_deg in [10, 20, 30] {
        let deformation = "Factored(depth: 3, width: 128, tx_encoding: Wavelengths(count: 10, longest_m: 80.0, \
                           shortest_m: 2.0), position_encoding: Waves(count: 32, reach: 4.0))";
        let splatting = Splatting {
            deformation: Plugin::parse(deformation).expect("a plugin"),
            projector: Plugin::parse("Mercator()").expect("a plugin"),
            rasterizer: Plugin::parse("AlphaBlending()").expect("a plugin"),
            calibration: Calibration::Physical,
            readout: Readout::ReceivedPower { sky_deg, filter_deg2: 30.0 },
        };
        let place = |k: usize| [k as f64 % 7.0, k as f64 / 4.0, 2.5];
        let receiver = |k| Receiver::new(format!("g{k}"), Pose { position: place(k), ..Pose::IDENTITY });
        let setup = MeasurementSetup {
            origin: Origin::ZERO,
            receivers: (0..21).map(receiver).collect(),
            task: Task::Power,
            plane: ImagePlane::plain(1, 1),
            frequencies_hz: Vec::new(),
            moving: End::Transmitter,
            transmitter: None,
            geodetic: None,
        };
        let stages = Stages::new(splatting, setup);
        let weights = stages.layout().init(&mut rng::stream(1, "weights", 0));
        let model = Model { stages, cloud: seeded_cloud(500), weights, training_positions: None };
        let (ready, queries) = (model.prepare(), (0..21).map(|r| Query::at(TX, r)).collect::<Vec<_>>());
        group.bench_function(BenchmarkId::new("a position, 21 receivers, sky of degrees", sky_deg), |b| {
            b.iter(|| ready.predict_many(&queries));
        });
    }
}

/// Forward and backward of the 8x256 network for one transmitter.
fn network(criterion: &mut Criterion, name: &str, outputs: Outputs) {
    let mut group = criterion.benchmark_group(name);
    for n in SIZES {
        let model = untrained(seeded_cloud(n), outputs);
        let deformation = &model.stages.settings::<Splatting>().expect("it draws splats").deformation;
        let (tx, pose) = ([TX.map(|x| x as Real)], &model.stages.pose());
        let inputs = DeformationInputs::new(&model.weights, &model.cloud.means, &tx, pose);
        let deltas = deformation.forward(&inputs, &None);
        group.bench_function(BenchmarkId::new("forward", n), |b| {
            b.iter(|| deformation.forward(&inputs, &None));
        });
        let mut d_weights = vec![0.0; model.weights.len()];
        let mut d_means = vec![[0.0; 3]; n];
        group.bench_function(BenchmarkId::new("backward", n), |b| {
            b.iter(|| {
                let sums = DeformationVjp { weights: &mut d_weights, means: Some(&mut d_means), positions: None };
                deformation.vjp(&inputs, &deltas, sums);
            });
        });
    }
}

/// Activation, projection and blending, forward and backward.
fn stages(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("stages");
    for n in SIZES {
        let model = untrained(seeded_cloud(n), Outputs::All);
        let splatting = model.stages.settings::<Splatting>().expect("it draws splats");
        let Splatting { deformation, projector, rasterizer, .. } = splatting;
        let (tx, pose, plane) = ([TX.map(|x| x as Real)], &model.stages.pose(), &model.stages.plane);
        let deltas = deformation.forward(&DeformationInputs::new(&model.weights, &model.cloud.means, &tx, pose), &None);
        let activation = splatting.activation();
        let geometry = activation.geometry(&model.cloud, &deltas, 0, None);
        let signals = activation.signals(&model.cloud, &deltas, 0..1);
        group.bench_function(BenchmarkId::new("activation", n), |b| {
            let both = || {
                let geometry = activation.geometry(&model.cloud, &deltas, 0, None);
                (geometry, activation.signals(&model.cloud, &deltas, 0..1))
            };
            b.iter(both);
        });
        let splats = projector.project(&geometry, pose, plane);
        group.bench_function(BenchmarkId::new("projection", n), |b| {
            b.iter(|| projector.project(&geometry, pose, plane));
        });
        let render = rasterizer.forward(splats.with_signals(&signals, CHANNELS, plane));
        group.bench_function(BenchmarkId::new("blending forward, with sorting", n), |b| {
            b.iter(|| rasterizer.forward(splats.with_signals(&signals, CHANNELS, plane)));
        });
        group.bench_function(BenchmarkId::new("sorting alone", n), |b| b.iter(|| rasterizer.prepare(&splats, plane)));
        let d_pixels = vec![1e-4; render.pixels.len()];
        let backward =
            || -> RenderVjp { rasterizer.backward(splats.with_signals(&signals, CHANNELS, plane), &render, &d_pixels) };
        let d = backward().splats;
        group.bench_function(BenchmarkId::new("blending backward", n), |b| b.iter(backward));
        group.bench_function(BenchmarkId::new("projection backward", n), |b| {
            b.iter(|| projector.project_vjp(&geometry, pose, plane, &splats, &d));
        });
    }
}

/// One training step with one transmitter: gates, forward, loss, backward, Adam.
fn step(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("step");
    SIZES.into_iter().for_each(|n| one_step(&mut group, "one transmitter", n));
}

fn one_step(group: &mut BenchmarkGroup<'_, WallTime>, name: &str, n: usize) {
    let data = scene::two_samples();
    let partition = Partition { train: vec![0, 1], ..Partition::default() };
    let pipeline = scene::pipeline(
        &format!("Seeded(count: {n})"),
        "deformation: Mlp(head_init: 0.001), training: (batch: 1, densify: (every: 0))",
    );
    // A fresh trainer for each, because a trained one would drift away from the seeded cloud; its first step, which meets
    // memory that nobody has touched, is not counted.
    let start = || {
        let mut trainer = pipeline.trainer(&data, &partition).expect("the pipeline can be trained");
        trainer.step().expect("a first step");
        trainer
    };
    group.bench_function(BenchmarkId::new(name, n), |b| {
        b.iter_batched(start, |mut trainer| trainer.step().map(|_| trainer), BatchSize::PerIteration);
    });
}

/// Prediction and training step from 10² to 10⁵ Gaussians.
fn scale(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("scale");
    for n in [100, 316, 1_000, 3_162, 10_000, 31_623, 100_000] {
        one(&mut group, "prediction", n, || untrained(seeded_cloud(n), Outputs::All));
        one(&mut group, "prediction, WRF-GS", n, || wrfgs(seeded_cloud(n)));
        one_step(&mut group, "step", n);
    }
}

/// From a transmitter's position to the picture, with everything prepared that no transmitter changes.
fn predict(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("predict");
    for n in SIZES {
        one(&mut group, "seeded", n, || untrained(seeded_cloud(n), Outputs::All));
        one(&mut group, "seeded, signals", n, || untrained(seeded_cloud(n), Outputs::Signals));
        one(&mut group, "seeded, WRF-GS", n, || wrfgs(seeded_cloud(n)));
    }
    for n in SIZES {
        unprepared(&mut group, n, || untrained(seeded_cloud(n), Outputs::All));
    }
    one(&mut group, "trained", 157, trained);
    for n in [16, 32, 64] {
        one(&mut group, "waves, Factored 4x240", n, || waves(n));
    }
    one(&mut group, "waves, 8x256", 64, || on_array(untrained(seeded_cloud(64), Outputs::Signals)));
    group.bench_function("waves, two models averaged/32", |b| {
        let pair = Ensemble::new(vec![waves(32), waves(32)]).expect("they share everything");
        let pair = pair.prepare();
        b.iter(|| pair.predict(TX.into()));
    });
    for n in SIZES {
        many(&mut group, "many at once", n, || untrained(seeded_cloud(n), Outputs::All));
        many(&mut group, "many at once, signals", n, || untrained(seeded_cloud(n), Outputs::Signals));
        many(&mut group, "many at once, WRF-GS", n, || wrfgs(seeded_cloud(n)));
    }
}

/// Times one prediction after the other. The model is made only where the benchmark is asked for.
fn one(group: &mut BenchmarkGroup<'_, WallTime>, name: &str, n: usize, model: impl Fn() -> Model) {
    let made = OnceCell::new(); // criterion asks once a sample
    let ready = OnceCell::new();
    group.bench_function(BenchmarkId::new(name, n), |b| {
        let ready = ready.get_or_init(|| made.get_or_init(&model).prepare());
        b.iter(|| ready.predict(TX.into()));
    });
}

/// Times predictions that prepare nothing, as the paper's table I does.
fn unprepared(group: &mut BenchmarkGroup<'_, WallTime>, n: usize, model: impl Fn() -> Model) {
    let made = OnceCell::new();
    group.bench_function(BenchmarkId::new("seeded, unprepared", n), |b| {
        let model = made.get_or_init(&model);
        b.iter(|| model.predict(TX));
    });
}

/// Times a batch and says how long one spectrum of it took.
fn many(group: &mut BenchmarkGroup<'_, WallTime>, name: &str, n: usize, model: impl Fn() -> Model) {
    const BATCH: u32 = 16;
    let made = OnceCell::new();
    let ready = OnceCell::new();
    group.bench_function(BenchmarkId::new(name, n), |b| {
        let ready = ready.get_or_init(|| made.get_or_init(&model).prepare());
        let txs: Vec<Query<'_>> = (0..BATCH).map(|b| TX.map(|x| x + 0.01 * f64::from(b)).into()).collect();
        b.iter_custom(|rounds| {
            let start = Instant::now();
            for _ in 0..rounds {
                std::hint::black_box(ready.predict_many(&txs));
            }
            start.elapsed() / BATCH
        });
    });
}

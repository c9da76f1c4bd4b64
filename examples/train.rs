//! Trains on arrays in memory, with a loop of one's own and a curve:
//! `cargo run --release --example train -- [MODEL.safetensors]`.
#![allow(clippy::print_stdout)] // it is a program

use pwrfgs::core::ssim;
use pwrfgs::prelude::*;
use std::path::Path;

const PIPELINE: &str = "Pipeline(
    name: \"arrays\",
    data: Arrays(),
    split: Random(test: 0.2),
    initializer: Grid(count: 200),
    deformation: Mlp(depth: 2, width: 64, skip: None, tx_frequencies: 1, outputs: Signals),
    pruners: [LearnableMask(lambda: 0.01, learning_rate: 0.02)],
    training: (steps: 400, batch: 8, densify_until: 100, prune_until: 300, prune_every: 50, densify: (every: 0)),
)";

/// A data source that makes its arrays itself. *Simulated*: one blob, where the transmitter is.
#[derive(Debug, Serialize, Deserialize)]
struct Arrays {}

#[typetag::serde]
impl DataSource for Arrays {
    fn load(&self, _: &Path, _: Progress<'_>) -> Result<Dataset> {
        let (width, height) = (90, 24);
        let plane = pwrfgs::raster::Mercator::default().plane(width, height);
        let mut rng = rng::stream(1, "positions", 0);
        let samples = (0..200).map(|id| {
            let tx = [1.6, 1.2, 0.8].map(|size| size * (f64::from(rng::uniform(&mut rng)) - 0.5) + 1.0);
            let distance = tx.iter().map(|v| v * v).sum::<f64>().sqrt();
            let value = |pixel: usize| {
                let direction = plane.direction((pixel % width) as Real, (pixel / width) as Real).expect("has angles");
                let cosine = (0..3).map(|k| tx[k] / distance * f64::from(direction[k])).sum::<f64>();
                (255.0 * (30.0 * (cosine - 1.0)).exp()).round() as u8
            };
            Sample { id, tx, spectrum: (0..width * height).map(value).collect() }
        });
        Dataset::new("arrays", Pose::IDENTITY, (width, height), samples.collect())
    }
}

fn main() -> Result<()> {
    let pipeline = Pipeline::parse(PIPELINE, Path::new("examples/train.rs"))?;
    let data = pipeline.data.load(Path::new("."), &|_, _| {})?;
    let partition = pipeline.split.split(&data, &mut rng::stream(pipeline.seed, "split", 0))?;
    let mut trainer = Trainer::new(&pipeline, &data, &partition)?;
    while !trainer.finished() {
        let now = trainer.step()?;
        if now.step % 20 == 0 {
            println!("{:4} N {:3} loss {:.4} {}", now.step, now.gaussians, now.loss, "▪".repeat((300.0 * now.loss) as usize));
        }
    }
    let model = trainer.model();
    let mean = |predict: &dyn Predict| {
        let score = |&i: &usize| ssim::evaluation(&predict.predict(data.samples[i].tx).clamped(), &data.image(i));
        partition.test.iter().map(score).sum::<f64>() / partition.test.len() as f64
    };
    let floor = pwrfgs::data::MeanSpectrum {}.fit(&data, &partition.train)?;
    println!("SSIM on test positions: model {:.3}, mean spectrum {:.3}", mean(&model), mean(floor.as_ref()));
    pwrfgs::model::file::write(Path::new(&std::env::args().nth(1).unwrap_or_else(|| "arrays.safetensors".into())), &model)
}

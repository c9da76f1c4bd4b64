//! Trains on arrays in memory with a custom training loop, and prints the loss:
//! `cargo run --release -p pwrfgs --example train -- [MODEL.safetensors]`.
#![allow(clippy::print_stdout)] // example program

use glam::DVec3;
use pwrfgs::core::ssim;
use pwrfgs::prelude::*;
use std::path::PathBuf;

const PIPELINE: &str = "Pipeline(
    name: \"arrays\", data: Lobes(), split: Random(test: 0.2), initializer: Grid(count: 200),
    deformation: Mlp(depth: 2, width: 64, skip: None, tx_frequencies: 1, outputs: Signals),
    pruners: [LearnableMask(lambda: 0.02, learning_rate: 0.02), OpacityThreshold(epsilon: 0.02)],
    training: (steps: 600, batch: 8, densify_until: 100, prune_until: 450, prune_every: 50, densify: (every: 0),
        optimizer: (network: Constant(0.01), opacity_logits: Constant(0.05), log_scales: Constant(0.02))),
)";

/// Data source with generated arrays. *Simulated*: one lobe in the direction of the transmitter.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
struct Lobes {}

#[typetag::serde]
impl DataSource for Lobes {
    fn load(&self, _: &std::path::Path, _: Progress<'_>) -> Result<Dataset> {
        let plane = pwrfgs::raster::Mercator::default().plane(90, 24);
        let mut rng = rng::stream(1, "positions", 0);
        let mut pixels = Vec::new();
        let samples = (0..200).map(|id| {
            let tx = [1.6, 1.2, 0.8].map(|size| size * (f64::from(rng::uniform(&mut rng)) - 0.5) + 1.0);
            let value = |pixel: usize| {
                let d = plane.direction((pixel % 90) as Real, (pixel / 90) as Real).expect("has angles");
                let cosine = DVec3::from(d.map(f64::from)).dot(DVec3::from(tx).normalize());
                (255.0 * (30.0 * (cosine - 1.0)).exp()) as u8
            };
            pixels.extend((0..90 * 24).map(value));
            Sample::new(id, tx)
        });
        let samples = samples.collect();
        let spectra = Spectra::grey((90, 24), pixels)?;
        let data = Dataset::new("arrays", Pose::IDENTITY, Vec::new(), samples, spectra)?;
        Ok(Dataset { simulation: Some(Simulation::default()), ..data }) // omit for measured data
    }
}

fn main() -> Result<()> {
    let pipeline = Pipeline::parse(PIPELINE, "examples/train.rs".as_ref())?;
    let data = pipeline.data.load(".".as_ref(), &|_, _| {})?;
    let partition = pipeline.split.split(&data, &mut rng::stream(pipeline.seed, "split", 0))?;
    let mut trainer = pipeline.trainer(&data, &partition)?;
    while !trainer.finished() {
        let StepReport { step, loss, gaussians, .. } = trainer.step()?;
        if step % 20 == 0 {
            println!("{step:4} N {gaussians:3} loss {loss:.4} {}", "▪".repeat((300.0 * loss) as usize));
        }
    }
    let model = trainer.model();
    let score = |p: &dyn Predict, i: usize| ssim::evaluation(&p.predict(data.query(i)).clamped(), &data.image(i));
    let mean = |p| partition.test.iter().map(|&i| score(p, i)).sum::<f64>() / partition.test.len() as f64;
    let floor = pwrfgs::data::MeanSpectrum {}.fit(&data, partition.known())?;
    println!("SSIM on test positions: model {:.3}, mean spectrum {:.3}", mean(&model), mean(floor.as_ref()));
    let out = std::env::args_os().nth(1).map_or_else(|| "arrays.safetensors".into(), PathBuf::from);
    pwrfgs::model::file::write(&out, &model)
}

//! What the benchmarks measure: seeded clouds of any size, and a trained model.

pub(crate) mod table;

use pwrfgs::core::{MeasurementSetup, Origin};
use pwrfgs::methods::Splatting;
use pwrfgs::networks::{Encoding, Factored, Mlp, Outputs, Wrfgs};
use pwrfgs::prelude::*;
use pwrfgs::raster::{AlphaBlending, ArrayResponse, Mercator};
use std::path::Path;

/// The sizes of the paper: its smallest, its middle and its largest model.
pub(crate) const SIZES: [usize; 3] = [157, 2_613, 65_469];
/// A transmitter of the measured set, metres.
pub(crate) const TX: [f64; 3] = [-0.084, -0.079, 0.996];
/// Columns and rows of a measured spectrum.
pub(crate) const PICTURE: (usize, usize) = (360, 90);

/// The receiver of the measured set s23: on a wall, looking along world −x, its y axis up.
pub(crate) const RECEIVER: Pose =
    Pose { position: [5.0, 0.26, 0.0], orientation: [0.512_916_02, -0.486_741_36, -0.486_741_36, 0.512_916_02] };

/// A cloud of `n` round Gaussians in a room of 6 x 5 x 3 m in front of [`RECEIVER`]; the same at every call.
///
/// Centres are uniform in the box that begins 0.3 m in front of the receiver. The radius of the projected splat (three
/// standard deviations along its longer axis, before the 0.3 px² blur) is log-normal with median 6 px · √(2613/n) and a
/// standard deviation of 0.5 in the logarithm, so that clouds of all sizes cover the picture about as often. Opacity is
/// uniform from 0.1 to 0.9, both channels of the signal are normal with standard deviation 0.1.
pub(crate) fn seeded_cloud(n: usize) -> GaussianCloud {
    let mut random = pwrfgs::core::rng::stream(0, "seeded cloud", n as u64);
    let median = 6.0 * (2_613.0 / n as Real).sqrt();
    let world_from_receiver = RECEIVER.world_from_receiver();
    let mut cloud = GaussianCloud::default();
    for _ in 0..n {
        let mut within = |low: Real, high: Real| low + (high - low) * pwrfgs::core::rng::uniform(&mut random);
        let local = pwrfgs::core::Vec3::new(within(-2.5, 2.5), within(-1.5, 1.5), within(0.3, 6.3));
        let opacity = within(0.1, 0.9);
        let mut normal = || pwrfgs::core::rng::normal(&mut random);
        let radius = median * (0.5 * normal()).exp();
        // One metre across the line of sight is 1/(ρ) radians of azimuth and 1/r of elevation: ρ is the smaller.
        let distance = local.truncate().length();
        let sigma = radius / 3.0 / pwrfgs::core::consts::DEG * distance;
        cloud.means.push((RECEIVER.position_vec() + world_from_receiver * local).to_array());
        cloud.log_scales.push([sigma.ln(); 3]);
        cloud.quats.push([(); 4].map(|()| normal()));
        cloud.opacity_logits.push(pwrfgs::core::logit(opacity));
        cloud.signals.push([0.1 * normal(), 0.1 * normal()]);
    }
    cloud
}

/// A model of `cloud` with an untrained 8x256 network whose outputs are small: the geometry stays what the cloud says.
pub(crate) fn untrained(cloud: GaussianCloud, outputs: Outputs) -> Model {
    let network = Mlp { head_init: 1e-3, outputs, ..Mlp::default() };
    let weights = network.layout().init(&mut pwrfgs::core::rng::stream(0, "network", 0));
    let projector = Mercator::default();
    let plane = projector.plane(PICTURE.0, PICTURE.1);
    let splatting = Splatting {
        deformation: boxed(network),
        projector: Plugin::from(Box::new(projector) as Box<dyn Projector>),
        rasterizer: Plugin::from(Box::new(AlphaBlending::default()) as Box<dyn Rasterizer>),
        calibration: pwrfgs::methods::Calibration::Physical,
        readout: pwrfgs::methods::Readout::Magnitude,
    };
    let stages = Stages::new(splatting, MeasurementSetup::spectra(Origin::ZERO, RECEIVER, plane));
    Model { stages, cloud, weights, training_positions: None }
}

/// A model of `cloud` with the untrained network of WRF-GS.
pub(crate) fn wrfgs(cloud: GaussianCloud) -> Model {
    let network = Wrfgs { gain: Some(1.0), ..Wrfgs::default() };
    let mut model = untrained(cloud, Outputs::Signals);
    model.weights = network.layout().init(&mut pwrfgs::core::rng::stream(0, "network", 0));
    model.stages = model.stages.with(|s: &mut Splatting| {
        s.deformation = boxed(network);
        s.readout = pwrfgs::methods::Readout::Real;
    });
    model
}

/// `n` waves on the array of the measured set, as in `s23-array.ron`, untrained.
pub(crate) fn waves(n: usize) -> Model {
    let network =
        Factored { width: 240, tx_encoding: Encoding::Waves { count: 64, reach: 24.0, seed: 0 }, ..Default::default() };
    let mut model = on_array(untrained(seeded_cloud(n), Outputs::Signals));
    model.weights = network.layout().init(&mut pwrfgs::core::rng::stream(0, "network", 0));
    model.stages = model.stages.with(|s: &mut Splatting| s.deformation = boxed(network));
    model
}

/// The model with its Gaussians heard by an array in place of blended.
pub(crate) fn on_array(mut model: Model) -> Model {
    let array = ArrayResponse { widened: false, ..ArrayResponse::default() };
    model.stages = model.stages.with(|s: &mut Splatting| {
        s.rasterizer = Plugin::from(Box::new(array) as Box<dyn Rasterizer>);
        s.readout = pwrfgs::methods::Readout::MinMax;
    });
    model
}

fn boxed(network: impl Deformation + 'static) -> Plugin<dyn Deformation> {
    Plugin::from(Box::new(network) as Box<dyn Deformation>)
}

/// A trained model: the file that the environment variable `PWRFGS_MODEL` names, else one trained here for 300 steps on
/// simulated spectra, with the full network and as many Gaussians as the paper's smallest model.
pub(crate) fn trained() -> Model {
    if let Some(path) = std::env::var_os("PWRFGS_MODEL") {
        return pwrfgs::model::file::read(Path::new(&path)).expect("PWRFGS_MODEL names a model file");
    }
    let pipeline = pipeline(
        "Grid(count: 157)",
        "training: (steps: 300, batch: 1, densify_until: 0, prune_until: 0, optimizer: (means: Constant(0.003)))",
    );
    let data = pipeline.data.load(Path::new("."), &|_, _| {}).expect("the teacher needs no file");
    let (train, test) = data.official.clone().expect("the teacher divides its samples");
    let mut trainer = pipeline
        .trainer(&data, &Partition { train, test, ..Partition::default() })
        .expect("the pipeline below can be trained");
    while !trainer.finished() {
        trainer.step().expect("numbers stay finite");
    }
    trainer.model()
}

/// A pipeline with the full network on simulated spectra.
pub(crate) fn pipeline(initializer: &str, rest: &str) -> Pipeline {
    let text = format!(
        "Pipeline(name: \"bench\", data: Teacher(samples: 50), initializer: {initializer}, \
         pruners: [LearnableMask(), OpacityThreshold()], {rest})"
    );
    Pipeline::parse(&text, Path::new("bench.ron")).expect("this text is a pipeline")
}

/// An initializer that gives [`seeded_cloud`], so that a trainer can start from it.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct Seeded {
    count: usize,
}

#[typetag::serde]
impl Initializer for Seeded {
    fn initialize(&self, _: &Scene, _: &ImagePlane, _: &mut pwrfgs::core::rng::Rng) -> Result<GaussianCloud> {
        Ok(seeded_cloud(self.count))
    }
}

/// Two samples in the measured geometry to train a seeded cloud on.
pub(crate) fn two_samples() -> Dataset {
    let mut random = pwrfgs::core::rng::stream(0, "two samples", 0);
    let sample = |id| Sample::new(id, TX.map(|x| x + 0.1 * f64::from(id)));
    let noise = (0..2 * PICTURE.0 * PICTURE.1).map(|_| pwrfgs::core::rng::below(&mut random, 256) as u8);
    let spectra = Spectra::grey(PICTURE, noise.collect()).expect("two pictures");
    Dataset::new("noise", RECEIVER, Vec::new(), vec![sample(1), sample(2)], spectra).expect("two spectra of noise")
}

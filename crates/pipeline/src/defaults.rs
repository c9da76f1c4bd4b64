//! Default values of pipeline fields.

use pwrfgs_core::{Baseline, Deformation, Initializer, Metric, Plugin, Projector, Rasterizer, Split, Task};
use pwrfgs_data::{Kriging, LogDistance, MeanSpectrum, NearestNeighbours, Official, Zero};
use pwrfgs_init::NoGaussians;
use pwrfgs_methods::{Readout, Splatting};
use pwrfgs_metrics::{
    Chamfer, ChannelSnr, DirectionError, GaussianCount, L1, Latency, ModelSize, PowerError, Psnr, RateRatio, Ssim,
};

/// Plugins of one kind with the given settings.
macro_rules! plugins {
    ($kind:ident: $($plugin:expr),+ $(,)?) => {
        vec![$(Plugin::from(Box::new($plugin) as Box<dyn $kind>)),+]
    };
}

/// Returns the default number of models of a run.
pub fn members() -> usize {
    1
}

/// Returns the default split: the one of the data set.
pub fn split() -> Plugin<dyn Split> {
    Plugin::from(Box::new(Official::default()) as Box<dyn Split>)
}

/// Returns the default initialiser, which creates no Gaussians.
pub fn initializer() -> Plugin<dyn Initializer> {
    Plugin::from(Box::new(NoGaussians::default()) as Box<dyn Initializer>)
}

/// Returns the default projector of splats.
pub fn projector() -> Plugin<dyn Projector> {
    Splatting::default().projector
}

/// Returns the default rasterizer of splats.
pub fn rasterizer() -> Plugin<dyn Rasterizer> {
    Splatting::default().rasterizer
}

/// Returns the default deformation of splats.
pub fn deformation() -> Plugin<dyn Deformation> {
    Splatting::default().deformation
}

/// Returns the default readout of splats for observations of `task`.
pub fn readout(task: Task) -> Readout {
    match task {
        Task::Power => Readout::RECEIVED,
        Task::Spectrum | Task::Channel => Readout::default(),
    }
}

/// Returns the default baselines for observations of `task`.
pub fn baselines(task: Task) -> Vec<Plugin<dyn Baseline>> {
    let nearest = |k: usize| NearestNeighbours { k: k.into() };
    match task {
        Task::Spectrum => plugins![Baseline: MeanSpectrum::default(), nearest(1), nearest(3), nearest(5)],
        Task::Power => {
            plugins![Baseline: MeanSpectrum::default(), LogDistance::default(), nearest(5), Kriging::default()]
        }
        Task::Channel => plugins![Baseline: Zero::default(), nearest(1), nearest(5)],
    }
}

/// Returns the default metrics for observations of `task`.
pub fn metrics(task: Task) -> Vec<Plugin<dyn Metric>> {
    let mut metrics = match task {
        Task::Spectrum => plugins![
            Metric: Ssim::default(), L1::default(), Psnr::default(), RateRatio::default(), DirectionError::default(),
        ],
        Task::Power => plugins![Metric: PowerError::default()],
        Task::Channel => plugins![Metric: ChannelSnr::default()],
    };
    let model_metrics =
        plugins![Metric: Chamfer::default(), GaussianCount::default(), ModelSize::default(), Latency::default()];
    metrics.extend(model_metrics);
    metrics
}

/// Returns the metrics of `validation.csv`, whose columns are `Headline::columns`: the first metric has all three, or two.
pub fn validation_metrics(task: Task) -> Vec<Plugin<dyn Metric>> {
    match task {
        Task::Spectrum => plugins![Metric: Ssim::default(), RateRatio { snr_db: 0.0 }],
        Task::Power => plugins![Metric: PowerError::default()],
        Task::Channel => plugins![Metric: ChannelSnr::default()],
    }
}

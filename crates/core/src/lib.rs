//! Plain data types, plugin traits and shared mathematics of pwrfgs. Only [`files`] accesses the file system.
//!
//! Data pass through these types in order: [`GaussianCloud`] (learned) → [`Primitives`] (in space, for one transmitter)
//! → [`Splats`] (on the image plane) → [`Render`] → [`Image`]. A stage is a function between two of them, and each
//! trait is a stage: [`Initializer`], [`Deformation`], [`Projector`], [`Rasterizer`], [`Pruner`], [`Metric`], with
//! [`DataSource`], [`Split`] and [`Baseline`] around them. Plugins hold no mutable state that affects results.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod adam;
mod array_geometry;
mod blocks;
mod cholesky;
mod cloud;
pub mod colour;
mod compatible;
mod data_source;
mod dataset;
mod deformation;
pub mod device;
mod device_steps;
pub mod docs;
mod error;
pub mod files;
mod geodetic;
mod image;
mod initializer;
pub mod kriging;
mod layout;
mod memory;
pub mod messages;
mod method;
mod metric;
mod misfit;
pub mod neighbours;
pub mod npy;
pub mod numbers;
pub mod plugin;
mod powers;
mod pruner;
mod rasterizer;
mod real;
pub mod rng;
mod scene;
mod setup;
mod shipped;
mod spectra;
mod splats;
pub mod ssim;
pub mod statistics;
mod stats;
pub mod tape;
mod task;
pub mod testing;
pub mod threads;

pub use adam::AdamUpdate;
pub use array_geometry::ArrayGeometry;
pub use blocks::{SiteSize, block_mean, block_of};
pub use cholesky::Cholesky;
pub use cloud::{COLUMN_NAMES, CloudEdit, ExtraColumn, GaussianCloud, RowOrigin};
pub use compatible::{Parts, TrainingNumbers, check_compatible};
pub use data_source::{Baseline, DataSource, FittingSet, LinkSet, Partition, Predict, Progress, Split, recognise};
pub use dataset::{Dataset, Simulation, Unmatched, check_receivers};
pub use deformation::{
    Conditions, Deformation, DeformationInputs, DeformationTraits, DeformationVjp, Deltas, KEPT_BYTES, LinearPart,
};
pub use device_steps::{DeviceStep, DeviceStepper, TrainingState};
pub use docs::{JsonSchema, schemars};
pub use error::{Error, Result, check_stopped, did_you_mean};
pub use geodetic::Geodetic;
pub use image::{AngleAxis, Camera, Elevation, Image, ImagePlane, Sampling, stretch};
pub use initializer::{Initializer, InitializerInput};
pub use layout::{Layout, WeightGroup, WeightSpec};
pub use memory::{check_memory, free_memory, peak_memory};
pub use method::{
    Activated, Appearance, Call, Cost, ForwardOutput, Method, MethodTraits, MethodVjp, Parameters, PixelSubset,
    SpectrumLoss, WantedInputs,
};
pub use metric::{Evaluation, Goal, Measurement, Metric, ModelFacts, Scope, StageTimes, UNSTEADY, Values};
pub use misfit::{Demand, Misfit, Requirement, SetupDifference};
pub use plugin::{Cache, Checked, Plugin, cached, registered};
pub use powers::{LoneValue, PowerUnit, lone_values, shared_values};
pub use pruner::{Budget, ColumnSpec, PruneTarget, Pruner, PrunerTraits, best, prune_contexts};
pub use rasterizer::{Projector, Rasterizer, Render, RenderVjp, SplatStats, SurveyInputs};
pub use real::{Lanes, Mat3, Real, Vec3, consts, logit, sigmoid, widest};
pub use scene::{
    End, Ends, Features, Link, Location, MAX_COORDINATE_M, Origin, Pose, Query, Receiver, Sample, Scene, carrier_fault,
    coordinate_fault, position_fault,
};
pub use setup::{LinkInputs, MeasurementSetup, ReceiverState};
pub use shipped::{ShippedFile, ShippedModel};
pub use spectra::{Number, Spectra};
pub use splats::{Primitives, SignalSplats, Splats};
pub use statistics::evenly;
pub use stats::{CloudStats, Needs, PassStatistics, Phase, Statistic, StepContext};
pub use tape::Gate;
pub use task::{
    Channels, Columns, Description, Headline, Observations, SPEED_OF_LIGHT, Task, gain_fault, gain_indices, gains_of,
    rows_of,
};

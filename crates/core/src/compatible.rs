//! `check_compatible`: whether plugins, settings, data and models fit together. No other code compares them.

use crate::messages::strip_control;
use crate::plugin::{Plugin, name_of, title_of, to_ron};
use crate::pruner::{PruneTarget, prune_contexts};
use crate::{
    Dataset, Demand, GaussianCloud, ImagePlane, MeasurementSetup, Method, MethodTraits, Misfit, Phase, Projector,
    Pruner, Receiver, Requirement, SetupDifference, Statistic, StepContext, Task,
};
use std::borrow::Cow;

/// Parts that must fit together. Absent parts are not compared: a pipeline has no data yet, a model file no pruners.
#[derive(Clone, Copy, Debug, Default)]
pub struct Parts<'a> {
    /// Measurement type, for parts without data and setup.
    pub task: Option<Task>,
    /// Receivers and measurement type; those of `data` by default.
    pub setup: Option<&'a MeasurementSetup>,
    /// Data.
    pub data: Option<&'a Dataset>,
    /// Method.
    pub method: Option<&'a dyn Method>,
    /// Demands of other plugins.
    pub demands: &'a [Demand],
    /// Pruners.
    pub pruners: &'a [Plugin<dyn Pruner>],
    /// Settings of the training.
    pub training: Option<TrainingNumbers>,
    /// Setup of a trained model that predicts the data.
    pub trained: Option<&'a MeasurementSetup>,
    /// Method and setup of a trained model from which the training starts.
    pub start: Option<(&'a dyn Method, &'a MeasurementSetup)>,
}

/// Settings of a training that depend on data, method or pruners.
#[derive(Clone, Copy, Debug)]
pub struct TrainingNumbers {
    /// `training.stride`.
    pub stride: usize,
    /// Number of selected pixels per spectrum; `None` for all, 0 for one per pair of a spectrum and a pixel.
    pub pixels: Option<usize>,
    /// Initial number of Gaussians, if known.
    pub initial: Option<usize>,
    /// Largest number of Gaussians after densification; 0 if there is none.
    pub densified: usize,
    /// `training.target_count`; 0 without a target.
    pub target: usize,
    /// Whether there is a prune step.
    pub prunes: bool,
}

/// Checks that all `parts` fit together.
///
/// # Errors
/// The first misfit, if two parts do not fit together or a demand is not met.
pub fn check_compatible(parts: &Parts<'_>) -> Result<(), Misfit> {
    let data_setup = parts.data.map(|data| MeasurementSetup::of(data, data.plane()));
    let setup = parts.setup.or(data_setup.as_ref());
    let parts = &Parts { setup, task: setup.map(|setup| setup.task).or(parts.task), ..*parts };
    let method = parts.method.map(|method| (method, method.traits()));
    refuse(method.as_ref().and_then(|(_, traits)| task_misfit(parts, traits)))?;
    let demand = method.as_ref().map(|(method, traits)| Demand::of("method", method.typetag_name(), traits.requires));
    parts.demands.iter().chain(&demand).try_for_each(|demand| check_demand(demand, parts))?;
    if let Some((method, traits)) = &method {
        check_pruners(parts, traits)?;
        check_training(parts, *method, traits)?;
        setup.map_or(Ok(()), |setup| check_setup(setup, traits))?;
        check_stages(parts, *method, traits)?;
        refuse(parts.data.and_then(|data| input_misfit(data, traits)))?;
    }
    let trained = parts.trained.zip(setup).and_then(|(model, setup)| setup_difference(model, setup));
    refuse(trained.map(Misfit::OtherData).or_else(|| start_misfit(parts)))
}

/// Returns the misfit as an error, if there is one.
fn refuse(misfit: Option<Misfit>) -> Result<(), Misfit> {
    misfit.map_or(Ok(()), Err)
}

/// Returns the misfit of a method that predicts another task than that of the data; `None` if they agree or are
/// unknown.
fn task_misfit(parts: &Parts<'_>, traits: &MethodTraits<'_>) -> Option<Misfit> {
    // The task of splats is that of their readout.
    let field = if traits.rasterizer.is_some() { "readout" } else { "method" };
    let (predicted, task) = traits.task.zip(parts.task).filter(|(predicted, task)| predicted != task)?;
    Some(Misfit::MethodTask(field, predicted, task))
}

/// Checks that a plugin supports the task, and that its requirements are met.
fn check_demand(demand: &Demand, parts: &Parts<'_>) -> Result<(), Misfit> {
    let Demand { field, plugin, tasks, requires } = *demand;
    let other = parts.task.filter(|task| !tasks.contains(task));
    refuse(other.map(|task| Misfit::PluginTask(field, plugin, task)))?;
    let unmet = requires.iter().find(|requirement| !is_met(**requirement, parts));
    refuse(unmet.map(|requirement| Misfit::Unmet(field, plugin, *requirement)))
}

/// Returns whether the parts meet a requirement; absent parts meet all.
fn is_met(requirement: Requirement, parts: &Parts<'_>) -> bool {
    let data = |is_met: fn(&Dataset) -> bool| parts.data.is_none_or(is_met);
    let setup = |is_met: fn(&MeasurementSetup) -> bool| parts.setup.is_none_or(is_met);
    match requirement {
        Requirement::Positions => data(|data| data.placed),
        Requirement::Inputs => data(|data| data.placed || data.features.is_some()),
        Requirement::Features => data(|data| data.features.is_some()),
        Requirement::NoFeatures => data(|data| data.features.is_none()),
        Requirement::Carriers => setup(|setup| setup.receivers.len() > 1 && Receiver::are_carriers(&setup.receivers)),
        Requirement::OneCarrier => setup(|setup| setup.carriers().is_empty()),
        Requirement::OneArray => setup(|setup| setup.receivers.len() == 1 || Receiver::are_carriers(&setup.receivers)),
        // An antenna has two rows: real and imaginary parts.
        Requirement::OneAntenna => setup(|setup| !setup.task.is_complex || setup.plane.height == 2),
        Requirement::FixedReceiver => setup(|setup| !setup.moving.is_receiver()),
        Requirement::Distances => data(|data| data.scene.has_distances()),
        Requirement::CentredAntenna => setup(|setup| {
            !setup.moving.is_receiver() || setup.receivers.iter().all(|receiver| receiver.antennas == [[0.0; 3]])
        }),
        Requirement::Directions => setup(|setup| !setup.task.has_pixels || setup.plane.direction(0.0, 0.0).is_some()),
        Requirement::Method(name) => parts.method.is_none_or(|method| method.typetag_name() == name),
    }
}

/// Checks pruners against each other, the target, the method and the task.
fn check_pruners(parts: &Parts<'_>, traits: &MethodTraits<'_>) -> Result<(), Misfit> {
    let (pruners, task) = (parts.pruners, parts.task.or(traits.task));
    // Pruners written in Python share one name: their classes and settings differ.
    let kind = |pruner: &Plugin<dyn Pruner>| if name_of(pruner) == "Python" { to_ron(pruner) } else { name_of(pruner) };
    let is_repeated = |(k, pruner): &(usize, &Plugin<dyn Pruner>)| {
        !pruner.traits().columns.is_empty() && pruners[..*k].iter().any(|other| kind(other) == kind(pruner))
    };
    refuse(pruners.iter().enumerate().find(is_repeated).map(|(_, pruner)| Misfit::ListedTwice(title_of(pruner))))?;
    refuse(parts.training.and_then(|training| target_misfit(&training, pruners)))?;
    let target = parts.training.map(|training| training.target).filter(|target| *target > 0);
    let prune_step = StepContext { round: 1, passed: 1, rounds: 1, target, ..StepContext::new(1, Phase::Prune, 0) };
    for (pruner, context) in pruners.iter().zip(prune_contexts(pruners, &prune_step)) {
        let needs = pruner.needs(&GaussianCloud::zeros(0), &context).statistics;
        // Methods of channels have no rasterizer.
        let advice = if task.is_some_and(|task| task.is_complex) { "" } else { "rasterizer: AlphaBlending() or " };
        let needs_blending = !traits.blends && needs.iter().any(|statistic| statistic.requires_blending());
        refuse(needs_blending.then(|| Misfit::NeedsBlending(title_of(pruner), advice)))?;
        let requires_pixels = |s: &Statistic| matches!(s, Statistic::Error { .. } | Statistic::Top { .. });
        let needs_pixels = task.is_some_and(|task| !task.has_pixels) && needs.iter().any(requires_pixels);
        refuse(needs_pixels.then(|| Misfit::NeedsPixels(title_of(pruner))))?;
    }
    Ok(())
}

/// Returns why the target cannot be reached, or why a pruner that requires one has none; `None` if all is well, and if a pruner is
/// unavailable: its traits are unknown, and training rejects it.
fn target_misfit(training: &TrainingNumbers, pruners: &[Plugin<dyn Pruner>]) -> Option<Misfit> {
    if pruners.iter().any(|pruner| pruner.traits().unavailable.is_some()) {
        return None;
    }
    let target = training.target;
    let goal = PruneTarget::of(pruners, target);
    if target > 0 && goal.is_none() {
        return Some(Misfit::TargetUnsupported(target));
    }
    let is_idle = |k: &usize| pruners[*k].traits().requires_target && goal.is_none_or(|goal| goal.pruner != *k);
    if let Some(idle) = (0..pruners.len()).find(is_idle).map(|k| title_of(&pruners[k])) {
        let first = goal.map(|goal| title_of(&pruners[goal.pruner]));
        return Some(first.map_or(Misfit::TargetMissing(idle.clone()), |first| Misfit::TargetTaken(first, idle)));
    }
    let goal = goal.filter(PruneTarget::is_exact)?;
    let no_step = || Misfit::NoPruneStep(title_of(&pruners[goal.pruner]), target);
    let few = training.initial.filter(|n| target > *n && !goal.can_reach(pruners, training.densified, target));
    (!training.prunes).then(no_step).or(few.map(|n| Misfit::TargetAboveStart(target, n)))
}

/// Checks the settings of the training against method and data.
fn check_training(parts: &Parts<'_>, method: &dyn Method, traits: &MethodTraits<'_>) -> Result<(), Misfit> {
    let Some(training) = parts.training else { return Ok(()) };
    let TrainingNumbers { stride, pixels, target, .. } = training;
    let selects = traits.supports_pixel_subset && parts.task.is_none_or(|task| task.has_pixels);
    refuse((pixels.is_some() && !selects).then_some(Misfit::SelectedPixels))?;
    let prunes = !parts.pruners.is_empty() || target > 0;
    refuse((prunes && !traits.has_gaussians()).then(|| Misfit::NothingToPrune(method.typetag_name())))?;
    let Some(setup) = parts.setup.filter(|setup| setup.task.has_pixels) else { return Ok(()) };
    let ImagePlane { width, height, .. } = setup.plane;
    let divides = |stride: &usize| width.is_multiple_of(*stride) && height.is_multiple_of(*stride);
    if !divides(&stride) {
        let divisors: Vec<String> = (1..=width.min(height)).filter(divides).map(|s| s.to_string()).collect();
        return Err(Misfit::Stride(stride, width, height, divisors.join(", ")));
    }
    let most = setup.value_count() / (stride * stride);
    refuse(pixels.filter(|count| *count > most).map(|count| Misfit::TooManyPixels(count, most)))
}

/// Checks that the projector of the method draws the spectra, or that other observations have the size of their receivers.
fn check_setup(setup: &MeasurementSetup, traits: &MethodTraits<'_>) -> Result<(), Misfit> {
    let MeasurementSetup { receivers, task, plane, .. } = setup;
    if let (true, Some(projector)) = (task.has_pixels, traits.projector) {
        return check_plane(&plane.whole(), &**projector);
    }
    let (subcarriers, [width, height]) = (setup.frequencies_hz.len(), [plane.width, plane.height]);
    // A channel has two rows per antenna: real and imaginary parts.
    let size = |receiver: &Receiver| if task.is_complex { [subcarriers, 2 * receiver.antennas.len()] } else { [1, 1] };
    let is_other = !task.has_pixels && receivers.iter().any(|receiver| size(receiver) != [width, height]);
    refuse(is_other.then_some(Misfit::Numbers(width, height, *task)))
}

/// Checks that the projector draws the image plane of data, which may be any plane that a file states.
fn check_plane(plane: &ImagePlane, projector: &dyn Projector) -> Result<(), Misfit> {
    let ImagePlane { width, height, .. } = *plane;
    let angles = |plane: &ImagePlane| plane.angles.map(|(az, el)| [az.first, az.step, el.first, el.step]);
    // Degrees: `ImagePlane::elevation` rounds to 1e-9.
    let is_near = |a: [f64; 4], b: [f64; 4]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
    let is_same = |drawn: &ImagePlane| {
        let alike = match (angles(plane), angles(drawn)) {
            (Some(a), Some(b)) => is_near(a, b),
            (a, b) => a == b,
        };
        alike && plane.wraps == drawn.wraps && plane.camera == drawn.camera
    };
    let elevation = plane.elevation().filter(|elevation| elevation.fault().is_none());
    let drawn = match (plane.camera, elevation) {
        (Some(camera), _) => projector.plane_of_camera(width, height, camera).map(Some)?,
        (None, elevation) => elevation.and_then(|elevation| projector.plane_of(width, height, elevation).ok()),
    };
    let is_drawn = drawn.is_some_and(|drawn| is_same(&drawn)) || is_same(&projector.plane(width, height));
    refuse((!is_drawn).then_some(Misfit::Plane))
}

/// Checks deformation, rasterizer and readout against the receivers and each other.
fn check_stages(parts: &Parts<'_>, method: &dyn Method, traits: &MethodTraits<'_>) -> Result<(), Misfit> {
    let deformation = traits.deformation.map(|deformation| deformation.traits());
    let rasterizer = traits.rasterizer;
    if let Some(setup) = parts.setup {
        let (carriers, receivers) = (setup.carriers().len(), setup.receivers.len());
        refuse((traits.shows_colours && !setup.task.has_pixels).then_some(Misfit::Colours))?;
        let ignored = carriers > 0 && deformation.is_some_and(|deformation| !deformation.reads_carrier);
        refuse(ignored.then_some(Misfit::CarriersIgnored(carriers)))?;
        let plane = method.plane(setup)?;
        // Pixels with angles or a camera turn with the receiver.
        let (moves, turns) = (setup.moving.is_receiver(), plane.angles.is_some() || plane.camera.is_some());
        refuse((moves && rasterizer.is_some() && !turns).then_some(Misfit::FixedCentre))?;
        let reason = if moves { "the receiver moves".into() } else { format!("the data have {receivers} receivers") };
        let is_read = (moves || receivers > 1) && deformation.is_some_and(|deformation| deformation.reads_receiver);
        refuse(is_read.then_some(Misfit::ReceiverRead(reason)))?;
        let is_one_wave = carriers > 0 && rasterizer.is_some_and(|rasterizer| !rasterizer.supports_carriers());
        refuse(is_one_wave.then_some(Misfit::OneWavelength))?;
    }
    let Some(rasterizer) = rasterizer else { return Ok(()) };
    let stride = parts.training.map_or(1, |training| training.stride);
    let plane = match (parts.setup, traits.projector) {
        (Some(setup), _) if setup.task.has_pixels && stride > 1 => Cow::Owned(setup.plane.strided(stride, [0, 0])),
        (Some(setup), _) => method.plane(setup)?,
        // A usual size: a pipeline alone has no data.
        (None, Some(projector)) => Cow::Owned(projector.plane(360, 90)),
        (None, None) => return Ok(()),
    };
    rasterizer.check_plane(&plane)?;
    refuse((rasterizer.is_coherent() && traits.channels < 2).then_some(Misfit::HalfWaves))?;
    refuse((rasterizer.is_coherent() && traits.shows_colours).then_some(Misfit::Colours))
}

/// Returns how the transmitter inputs of the data differ from those of the method, or why no method can use them; `None` if they
/// agree.
fn input_misfit(data: &Dataset, traits: &MethodTraits<'_>) -> Option<Misfit> {
    let width = data.features.as_ref().map(|features| features.width);
    match width {
        None if !data.placed => return Some(Misfit::NoInputs),
        Some(3) => return Some(Misfit::ThreeFeatures), // 3 inputs are always a position
        _ if width.unwrap_or(3) == traits.inputs => return None,
        _ => {}
    }
    let inputs = |features: Option<usize>| features.map_or("a position".into(), |n| format!("{n} features"));
    let advice = match (traits.deformation, width) {
        (None, Some(width)) => format!("set it in the method, such as Nerf2(features: {width})"),
        (Some(_), Some(width)) => format!("use deformation: Factored(tx_encoding: Features(width: {width}))"),
        (_, None) => "remove `features` of the method, or `Features` of the deformation".into(),
    };
    Some(Misfit::Inputs(inputs(Some(traits.inputs).filter(|n| *n != 3)), inputs(width), advice))
}

/// Returns the first difference between the setup of a trained model and that of data; `None` if there is none.
fn setup_difference(model: &MeasurementSetup, data: &MeasurementSetup) -> Option<SetupDifference> {
    let task = data.task;
    let receiver_difference = |(trained, measured): (&Receiver, &Receiver)| {
        let carriers = trained.carrier_hz.zip(measured.carrier_hz).filter(|(a, b)| !is_same_frequency(*a, *b));
        // The name of a single receiver is a placeholder and is not compared.
        let is_renamed = trained.name != measured.name && !task.has_pixels && data.receivers.len() > 1;
        let names = || SetupDifference::Name(strip_control(&trained.name), strip_control(&measured.name));
        carriers.map(|(a, b)| SetupDifference::Carrier(a, b)).or_else(|| is_renamed.then(names))
    };
    let mut receivers = model.receivers.iter().zip(&data.receivers);
    observation_difference(model, data)
        .or_else(|| receivers.find_map(receiver_difference))
        .or_else(|| frequency_difference(&model.frequencies_hz, &data.frequencies_hz))
}

/// Returns the first difference in task, moving end, image plane or number of receivers; `None` if there is none.
fn observation_difference(model: &MeasurementSetup, data: &MeasurementSetup) -> Option<SetupDifference> {
    let task = data.task;
    let [trained, measured] = [model, data].map(|setup| (setup.plane.width, setup.plane.height));
    let text = |size: (usize, usize)| task.size_text(size).unwrap_or_default();
    let elevations = model.plane.elevation().zip(data.plane.elevation()).filter(|(a, b)| a != b);
    let counts = [model, data].map(|setup| setup.receivers.len());
    let differences = [
        (model.task != task).then_some(SetupDifference::Task(model.task, task)),
        (model.moving != data.moving).then_some(SetupDifference::Moves),
        (trained != measured).then(|| SetupDifference::Size(task, text(trained), text(measured))),
        (model.plane.camera != data.plane.camera).then_some(SetupDifference::Camera),
        elevations.map(|(a, b)| SetupDifference::Elevations(a, b)),
        (counts[0] != counts[1]).then_some(SetupDifference::Receivers(counts[0], counts[1])),
    ];
    differences.into_iter().flatten().next()
}

/// Returns the first difference of subcarrier frequencies, Hz; `None` if they agree. Equal image planes have equally many.
fn frequency_difference(model: &[f64], data: &[f64]) -> Option<SetupDifference> {
    let other = model.iter().zip(data).find(|(a, b)| !is_same_frequency(**a, **b));
    other.map(|(a, b)| SetupDifference::Frequency(*a, *b))
}

/// Returns whether two frequencies, Hz, agree within one part in a million: files round them.
fn is_same_frequency(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-6 * a.abs()
}

/// Returns why a training cannot start from the trained model of `parts`; `None` if it can, or the model or a setup is absent.
fn start_misfit(parts: &Parts<'_>) -> Option<Misfit> {
    let ((method, model), setup) = parts.start.zip(parts.setup)?;
    let text = |method: &dyn Method| serde_json::to_string(method).unwrap_or_default();
    let key = |setup: &MeasurementSetup| (setup.receivers.clone(), setup.moving);
    let is_other = parts.method.is_some_and(|other| text(other) != text(method)) || key(model) != key(setup);
    let moved = (model.origin != setup.origin).then_some(Misfit::OtherOrigin);
    moved.or_else(|| is_other.then_some(Misfit::OtherMethod))
}

#[cfg(test)]
mod tests {
    #[test]
    fn reports_first_frequency_that_differs() {
        let difference = super::frequency_difference(&[5e9, 5.1e9], &[5e9, 5.2e9]).unwrap();
        let message = "a subcarrier of the model is at 5100000000 Hz, but at 5200000000 Hz in the data";
        assert_eq!(difference.to_string(), message);
    }
}

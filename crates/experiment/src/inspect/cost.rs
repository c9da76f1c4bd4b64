//! Size and cost of a run as a table.

use super::Preview;
use crate::text::{align_columns, format_duration, format_gigabytes, format_length, grouped};
use pwrfgs_core::plugin::name_of as plugin_name;
use pwrfgs_train::{Rays, TimeEstimate, Training};

/// Load average per core above which the machine is busy.
const IDLE: f64 = 0.25;
/// Upper over lower quartile of the times of equal steps above which the spread is printed; short steps spread on an
/// idle machine too.
const STEADY: f64 = 1.25;

impl Preview {
    /// Returns the time of the training of all models.
    fn time_of_all(&self) -> TimeEstimate {
        let models = self.pipeline.members as f64;
        let seconds = self.time.seconds.map(|seconds| models * seconds);
        TimeEstimate { seconds, search_seconds: self.time.search_seconds.map(|s| models * s), ..self.time }
    }

    /// Formats size and cost of the run as a table.
    pub fn table(&self) -> String {
        let (training, n) = (&self.pipeline.training, |count: usize| grouped(count as i64));
        let [train, validation, test] = self.samples.map(n);
        let free = self.free_bytes.map_or_else(String::new, |free| format!(", {} available", format_gigabytes(free)));
        let test_distance = match self.test_distance {
            distance if distance.is_nan() => "unknown: the data have no positions".to_owned(),
            distance => format!("{} to the nearest training transmitter (median)", format_length(distance)),
        };
        let gaussians = match self.time.start.gaussians {
            0 => "none".to_owned(),
            count => format!("{} initially", n(count)),
        };
        let mut rows = vec![
            ("data", format!("{}: {}", self.title, self.observed)),
            ("samples", format!("{train} training, {validation} validation, {test} test")),
            ("test distance", test_distance),
            ("Gaussians", gaussians),
            ("network", format!("{} weights", n(self.weights))),
            ("pruners", join_or_none(&self.pipeline.pruners.iter().map(plugin_name).collect::<Vec<_>>())),
            ("steps", describe_steps(training)),
            ("phases", describe_phases(training)),
            ("memory", format!("about {}{free}", format_gigabytes(self.loaded_bytes + self.step_bytes))),
            ("time", describe_time(&self.time_of_all(), has_unlimited_densification(training))),
            ("machine", describe_machine(self)),
        ];
        let pose = self.summary.pose.as_ref().map(|pose| ("pose", pose.verdict.title().to_owned()));
        let models = self.pipeline.members;
        let each =
            || format!("{models}, one after another, each without a part of the known samples; the time is of all");
        rows.extend((models > 1).then(|| ("models", each())));
        rows.extend(self.device.map(|name| ("device", format!("network on {name}"))));
        // After the first row, `data`.
        rows.splice(1..1, self.summary.facts.iter().cloned().chain(pose));
        rows.extend(self.outlook.iter().map(|sentence| ("pruning", sentence.clone())));
        align_columns(&rows.into_iter().map(|(name, value)| vec![name.to_owned(), value]).collect::<Vec<_>>(), 2)
    }
}

/// Joins names by commas; `none` without any.
fn join_or_none(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Describes the number of training steps and the batch of a step.
fn describe_steps(training: &Training) -> String {
    let (steps, n) = (grouped(training.steps as i64), |count: usize| grouped(count as i64));
    match training.rays {
        Rays::All => format!("{steps} of {} transmitters", n(training.batch)),
        Rays::Same(rays) => format!("{steps} of {} rays of {} transmitters", n(rays), n(training.batch)),
        Rays::Each(pairs) => format!("{steps} of {} pairs of spectrum and pixel", n(pairs)),
    }
}

/// Describes the phases of algorithm 1 by their steps.
fn describe_phases(training: &Training) -> String {
    let steps = |count: u64| grouped(count as i64);
    let phase = |(from, to, name): (u64, u64, &str)| {
        let last = to.min(training.steps);
        (from < last).then(|| format!("{name} from step {} to {}", steps(from + 1), steps(last)))
    };
    // Last step before a phase, its last step, and its name.
    let phases = [
        (0, training.densify_until, "densify"),
        (training.densify_until, training.prune_until, "prune"),
        (training.prune_until, training.steps, "finetune"),
    ];
    join_or_none(&phases.into_iter().filter_map(phase).collect::<Vec<_>>())
}

/// Returns whether densification may add Gaussians, without a maximum number.
fn has_unlimited_densification(training: &Training) -> bool {
    training.densify.max_gaussians == 0
        && training.densify.every > 0
        && training.densify.from < training.densify_until.min(training.steps)
}

/// Describes the expected time of the initial search and of training, with its range, and the timed steps; `may_grow`
/// adds that densification lengthens it.
fn describe_time(time: &TimeEstimate, may_grow: bool) -> String {
    let range = |seconds: [f64; 2]| {
        let [shortest, longest] = seconds.map(format_duration);
        if shortest == longest { shortest } else { format!("{shortest} to {longest}") }
    };
    let TimeEstimate { seconds: [shortest, expected, longest], search_seconds: search, start, end, .. } = time;
    let seconds = [*shortest, *longest];
    let search_text = if search[1] > 0.0 {
        let whole = range([0, 1].map(|k| search[k] + seconds[k]));
        format!("{whole}: {} of initial search, then ", range(*search))
    } else {
        String::new()
    };
    let [low, high] = seconds.map(format_duration);
    let training = if low == high { low } else { format!("about {} ({low} to {high})", format_duration(*expected)) };
    let n = |count: usize| grouped(count as i64);
    let [first, last] = [start, end].map(|steps| format_step_time(steps.step_seconds) + " per step");
    let steps = if end.gaussians == start.gaussians {
        first
    } else {
        format!("{first} with N = {}, {last} with N = {}", n(start.gaussians), n(end.gaussians))
    };
    format!(
        "{search_text}{training} of training ({steps}){}",
        if may_grow { "; more if densification adds Gaussians" } else { "" }
    )
}

/// Describes the load of the machine, and the spread of the timed steps if it is large.
fn describe_machine(preview: &Preview) -> String {
    let is_loaded = preview.load.is_some_and(|(load, cores)| load > IDLE * cores as f64);
    let load = preview
        .load
        .map(|(load, cores)| format!("load average {load:.1} on {cores} core{}", if cores == 1 { "" } else { "s" }));
    let varies =
        (preview.time.spread > STEADY).then(|| format!("equal steps vary by a factor of {:.1}", preview.time.spread));
    let state = match preview.load {
        _ if is_loaded => "busy, an idle machine is faster",
        Some(_) => "idle",
        None => "load unknown",
    };
    [Some(state.to_owned()), load, varies].into_iter().flatten().collect::<Vec<_>>().join("; ")
}

/// Formats the seconds of a training step, in milliseconds below one second: `12.0 ms` or `26.1 s`.
fn format_step_time(seconds: f64) -> String {
    if seconds < 1.0 { format!("{:.1} ms", 1e3 * seconds) } else { format!("{seconds:.1} s") }
}

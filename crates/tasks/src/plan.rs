//! Positions to measure next.

mod checks;
mod correlation;

use crate::plane::PlaneBounds;
use checks::{MOST, check_count, check_distance};
use clap::Args;
use correlation::{describe_length, first_correlation};
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::kriging::Correlation;
use pwrfgs_core::statistics::{self, evenly, mean};
use pwrfgs_core::{Dataset, Error, Location, Result};
use pwrfgs_experiment::statistics::{Blocks, Difference};
use pwrfgs_experiment::text::{Lines, align_columns, fixed, grouped, number};
use pwrfgs_experiment::{Session, run_stage};
use pwrfgs_model::Ensemble;
use pwrfgs_planning::{Survey, SurveyPlan, default_correlation, kriging_scores, learn_correlation, select_farthest};
use pwrfgs_report::draw::survey::SurveyMap;
use schemars::JsonSchema;
use serde::Deserialize;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::Ordering;

/// Largest number of transmitters that a choice is scored on.
const TESTED: usize = 500;
/// Regular positions are as good if their variance exceeds that of the plan by at most this share.
const ALIKE: f64 = 0.02;
/// Width of the image in print, millimetres.
const WIDTH_MM: f64 = 120.0;
/// Largest number of covariances between candidates and region.
const MOST_PAIRS: usize = 1 << 25;
/// Largest number of known measurements that are used, evenly chosen.
const MOST_KNOWN: usize = 2_000;

/// Settings of [`plan`].
#[derive(Clone, Debug, Args, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlanSettings {
    /// Number of positions to select
    #[arg(long, value_name = "N")]
    pub count: usize,
    /// Extent in x and y of the region to predict, metres [default: all candidates]
    #[arg(long, value_name = "X0,X1,Y0,Y1", allow_hyphen_values = true)]
    #[serde(default)]
    pub region: Option<String>,
    /// Replay a survey on the data folder: estimate the length scale of the Gaussian process only from measurements
    /// selected so far
    #[arg(long, requires = "source", conflicts_with_all = ["candidates", "floor", "length_scale"])]
    #[serde(default)]
    pub simulate: bool,
    /// Fixed length scale of the Gaussian process in metres, instead of an estimate
    #[arg(long, value_name = "M")]
    #[serde(default)]
    pub length_scale: Option<f64>,
    /// Random seed of the random selection that the plan is compared with
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    #[serde(default)]
    pub seed: u64,
}

/// Input of a plan: positions in metres, world frame, and observations.
#[derive(Clone, Debug, Default)]
pub struct PlanInput {
    /// Title of the plan.
    pub title: String,
    /// Positions that can be measured.
    pub candidates: Vec<[f64; 3]>,
    /// Positions with measurements.
    pub measured: Vec<[f64; 3]>,
    /// Ends of the links that do not move, usually receivers, without estimated positions.
    pub fixed: Vec<[f64; 3]>,
    /// Observations at `measured`, or at the candidates if that is empty.
    pub data: Option<Dataset>,
}

impl PlanInput {
    /// Returns the positions of `data`, all as candidates that are not measured yet.
    ///
    /// # Errors
    /// Data without positions.
    pub fn of_data(data: Dataset) -> Result<Self> {
        if !data.placed || data.features.is_some() {
            let problem = "the data have no transmitter positions; name data with positions";
            return Err(Error::Config(problem.into()));
        }
        Ok(Self {
            title: data.title.clone(),
            candidates: data.locations.iter().map(Location::position).collect(),
            fixed: data.scene.known_ends(),
            measured: Vec::new(),
            data: Some(data),
        })
    }

    /// Returns the training positions of a model as known measurements, without candidates; `None` if it has none.
    pub fn of_model(ensemble: &Ensemble, title: &str) -> Option<Self> {
        let measured = ensemble.training_positions();
        let setup = &ensemble.members()[0].stages.setup;
        (!measured.is_empty()).then(|| Self {
            title: title.into(),
            measured,
            fixed: setup.known_ends(),
            ..Self::default()
        })
    }

    /// Returns the input with new `candidates`; `path` names them in messages. Earlier candidates become known measurements, of
    /// which at most 2,000, evenly chosen, are kept.
    ///
    /// # Errors
    /// Candidates that are far from all known measurements: probably another frame or unit.
    pub fn with_candidates(mut self, candidates: Vec<[f64; 3]>, path: &Path) -> Result<Self> {
        self.measured.append(&mut self.candidates);
        check_distance(&candidates, &self.measured, path)?;
        let measured = evenly(&self.measured, MOST_KNOWN);
        Ok(Self { candidates, measured, ..self })
    }

    /// Returns the candidates for which `is_inside` holds, evenly thinned so that their covariances with all candidates
    /// fit into memory.
    fn thinned_candidates(&self, is_inside: impl Fn([f64; 3]) -> bool) -> Vec<[f64; 3]> {
        let positions: Vec<[f64; 3]> =
            self.candidates.iter().copied().filter(|position| is_inside(*position)).collect();
        evenly(&positions, MOST_PAIRS / self.candidates.len().clamp(1, MOST))
    }

    /// Returns `simulated ` if the observations are, else an empty text.
    fn simulated_prefix(&self) -> &'static str {
        if self.data.as_ref().is_some_and(Dataset::is_simulated) { "simulated " } else { "" }
    }
}

/// A plan beside other choices of the same size.
#[derive(Debug)]
pub struct Plan {
    /// Selected positions in order: indices of the candidates.
    pub order: Vec<usize>,
    /// Mean variance over the region before and after each position.
    pub variances: Vec<f64>,
    /// Table of the choices, with a verdict.
    pub text: String,
}

/// Selects positions to measure next, of the candidates of `input`.
///
/// # Errors
/// Invalid settings, no candidates, no candidate in the region, or [`Error::Stopped`].
pub fn plan(input: &PlanInput, settings: &PlanSettings, session: &mut Session<'_>) -> Result<Plan> {
    check_count(settings.count, input.candidates.len())?;
    let region = select_region(settings, input)?;
    let stop = session.stop;
    let subset = run_stage(session.observer, "thinning candidates", |progress| {
        select_farthest(&input.candidates, MOST, |done| {
            progress(done, MOST);
            !stop.load(Ordering::Relaxed)
        })
    });
    session.check_stopped()?;
    let candidates: Vec<[f64; 3]> = subset.iter().map(|&j| input.candidates[j]).collect();
    let survey = Survey::new(&candidates, &region, &input.measured);
    let measured = input.data.as_ref().filter(|_| !input.measured.is_empty());
    let start = first_correlation(settings.length_scale, measured, &region)?;
    let candidate_indices = |order: &[usize]| order.iter().map(|&j| subset[j]).collect::<Vec<usize>>();
    let learn = |order: &[usize]| {
        input
            .data
            .as_ref()
            .filter(|_| settings.simulate)
            .and_then(|data| learn_correlation(data, &candidate_indices(order)))
    };
    let selected = run_stage(session.observer, "selecting positions", |progress| {
        survey.select(start, settings.count, learn, |done| {
            progress(done, settings.count);
            !stop.load(Ordering::Relaxed)
        })
    });
    session.check_stopped()?;
    let mut choices = list_choices(&survey, &selected, settings.seed);
    choices.iter_mut().for_each(|choice| choice.order = candidate_indices(&choice.order));
    let gain = score_choices(&mut choices, input, session)?;
    let correlations = [&selected.correlation, &default_correlation(&region)];
    let learned = &choices[0].order[..selected.learned_from];
    let origin = match settings.length_scale {
        Some(_) => "",
        None => describe_length(input.data.as_ref(), correlations, learned),
    };
    let text = format_table(&choices, gain, (&selected.correlation, origin), input);
    let Choice { order, variances, .. } = choices.swap_remove(0);
    Ok(Plan { order, variances, text })
}

/// Returns the candidates in the region of `--region`, all without this option; an error if the region has none.
fn select_region(settings: &PlanSettings, input: &PlanInput) -> Result<Vec<[f64; 3]>> {
    let Some(text) = &settings.region else { return Ok(input.thinned_candidates(|_| true)) };
    let bounds = PlaneBounds::parse("--region", text, ["x", "y"])?;
    let region = input.thinned_candidates(|[x, y, _]| bounds.has_point([x, y]));
    if region.is_empty() {
        let [(x0, x1), (y0, y1)] =
            [0, 1].map(|k| statistics::bounds(input.candidates.iter().map(|position| position[k])));
        return Err(Error::Config(format!(
            "--region {text}: no candidate inside; candidates have x from {} to {} m and y from {} to {} m",
            number(x0),
            number(x1),
            number(y0),
            number(y1)
        )));
    }
    Ok(region)
}

/// Selection of positions with its results.
struct Choice {
    name: String,
    order: Vec<usize>,
    /// Mean variance over the region before and after each position.
    variances: Vec<f64>,
    /// Score of each test link; empty without observations.
    scores: Vec<f64>,
}

impl Choice {
    /// Returns the mean variance over the region after all positions have been measured.
    fn final_variance(&self) -> f64 {
        self.variances.last().copied().unwrap_or(f64::NAN)
    }
}

/// Lists the plan, then the regular, random and largest-variance choice of the same size, without scores.
fn list_choices(survey: &Survey, plan: &SurveyPlan, seed: u64) -> Vec<Choice> {
    let (count, correlation) = (plan.order.len(), plan.correlation);
    let choice = |(name, order): (String, Vec<usize>)| Choice {
        name,
        variances: survey.mean_variances(correlation, &order),
        order,
        scores: Vec::new(),
    };
    let orders = [
        ("plan: least integrated variance".to_owned(), plan.order.clone()),
        ("regular: every k-th candidate".into(), survey.select_regular(count)),
        (format!("random (seed {seed})"), survey.select_random(count, seed)),
        ("largest variance".into(), survey.select_by_variance(correlation, count)),
    ];
    orders.into_iter().map(choice).collect()
}

/// Sets the scores of each choice: of Kriging fitted to its measurements, on transmitters in no choice. Returns the gain of
/// the plan over the regular choice; `None` without measured candidates or finite scores.
fn score_choices(choices: &mut [Choice], input: &PlanInput, session: &mut Session<'_>) -> Result<Option<Difference>> {
    let Some(data) = input.data.as_ref().filter(|_| input.measured.is_empty()) else { return Ok(None) };
    let test = test_links(data, choices);
    if test.is_empty() {
        return Ok(None);
    }
    let total = choices.len();
    for (k, choice) in choices.iter_mut().enumerate() {
        session.check_stopped()?;
        session.observer.on_stage("scoring", k, total);
        choice.scores = kriging_scores(data, &choice.order, &test)?;
    }
    Ok(mean_gain(data, &test, &choices[0], &choices[1])) // in the order of `list_choices`
}

/// Computes the mean gain of the scores of the plan over the regular choice, with an interval over blocks of positions,
/// since neighbours and the links of one transmitter are not independent. `test` are the scored links. `None` without finite
/// scores.
fn mean_gain(data: &Dataset, test: &[usize], plan: &Choice, regular: &Choice) -> Option<Difference> {
    let sign = if data.task().headline.higher { 1.0 } else { -1.0 };
    let samples = || test.iter().map(|i| data.sample(*i));
    let blocks = Blocks::new(&samples().map(|sample| (sample.id, data.placed.then_some(sample.position()))).collect());
    let gains = plan.scores.iter().zip(&regular.scores).map(|(a, b)| sign * (a - b));
    Difference::of(&[blocks.block_sums(samples().map(|sample| sample.id).zip(gains))])
}

/// Lists the links of transmitters that are in no choice, at most [`TESTED`] transmitters.
fn test_links(data: &Dataset, choices: &[Choice]) -> Vec<usize> {
    let mut is_taken = vec![false; data.locations.len()];
    choices.iter().flat_map(|choice| &choice.order).for_each(|&j| is_taken[j] = true);
    let remaining: Vec<usize> = (0..is_taken.len()).filter(|&j| !is_taken[j]).collect();
    data.links_of(&evenly(&remaining, TESTED))
}

impl Plan {
    /// Writes `plan.csv` and `plan.png` into `folder`.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, input: &PlanInput, folder: &NewFolder) -> Result<()> {
        let mut lines = Lines::new(["order", "candidate", "x", "y", "z", "mean_variance"]);
        for (k, &j) in self.order.iter().enumerate() {
            let [x, y, z] = input.candidates[j].map(|v| v.to_string());
            let [order, candidate] = [k + 1, j + 1].map(|v| v.to_string());
            lines.put([&order, &candidate, &x, &y, &z, &format!("{:.6}", self.variances[k + 1])]);
        }
        let flat = |[x, y, _]: &[f64; 3]| [*x, *y];
        let map = SurveyMap {
            title: format!("{}: {} positions to measure", input.title, grouped(self.order.len() as i64)),
            candidates: input.candidates.iter().map(flat).collect(),
            known: input.measured.iter().map(flat).collect(),
            selected: self.order.iter().map(|&j| flat(&input.candidates[j])).collect(),
            receivers: input.fixed.iter().map(flat).collect(),
        };
        folder.put("plan.csv", lines.text())?;
        folder.put("plan.png", map.draw().png(WIDTH_MM))
    }
}

/// Formats the table of the choices, with the correlation, the origin of its length scale and a comparison with the regular
/// choice.
fn format_table(
    choices: &[Choice],
    gain: Option<Difference>,
    (correlation, origin): (&Correlation, &str),
    input: &PlanInput,
) -> String {
    let task = input.data.as_ref().map(Dataset::task).filter(|_| !choices[0].scores.is_empty());
    let mut header = vec!["choice".to_owned(), "mean variance".into()];
    header.extend(task.map(|task| format!("{} of Kriging", task.headline.name)));
    let mut lines = vec![header];
    for choice in choices {
        let mut line = vec![choice.name.clone(), fixed(choice.final_variance(), 4)];
        line.extend(task.map(|_| fixed(mean(choice.scores.iter().copied()), 4)));
        lines.push(line);
    }
    let Correlation { scales: [length, ..], noise, .. } = correlation;
    let mut text = align_columns(&lines, 1);
    _ = write!(
        text,
        "\n{} candidates, {} known measurements; exponential correlation, length scale {} m{origin}, noise {} of the variance\n",
        grouped(input.candidates.len() as i64),
        grouped(input.measured.len() as i64),
        number(*length),
        number(*noise)
    );
    if input.candidates.len() > MOST {
        let most = grouped(MOST as i64);
        _ = writeln!(text, "positions are selected among {most} candidates, the farthest from each other");
    }
    if let Some(task) = task {
        let (test, data) = (grouped(choices[0].scores.len() as i64), input.simulated_prefix());
        _ = writeln!(text, "scores are those of {test} {data}{} in no choice", task.counted[1]);
    }
    text + describe_verdict(&choices[0], &choices[1], gain)
}

/// Describes which of plan and regular choice is better: by scores if there are any, otherwise by variance.
fn describe_verdict(plan: &Choice, regular: &Choice, gain: Option<Difference>) -> &'static str {
    let is_better = match gain {
        Some(gain) => gain.is_clear() && gain.mean > 0.0,
        None => regular.final_variance() > (1.0 + ALIKE) * plan.final_variance(),
    };
    if is_better {
        "the plan is better than the regular choice\n"
    } else {
        "the regular choice is as good: measure every k-th candidate if that is simpler\n"
    }
}

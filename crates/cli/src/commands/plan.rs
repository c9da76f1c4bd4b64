//! `pwrfgs plan`: positions to measure next.

mod source;

use super::map::PlaneBounds;
use crate::interrupt::stop_flag;
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::statistics::{Blocks, Difference};
use pwrfgs::experiment::text::{Lines, aligned, fixed, grouped, number};
use pwrfgs::experiment::{Observer as _, staged};
use pwrfgs::planning::{Survey, SurveyPlan, default_correlation, kriging_scores, learn_correlation};
use pwrfgs::report::draw::survey::SurveyMap;
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::kriging::Correlation;
use pwrfgs_core::statistics::{self, evenly, mean};
use pwrfgs_core::{Dataset, Error, Result, check_stopped};
use source::{PlaceOptions, Places, read_places};
use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

/// Largest number of transmitters that a choice is scored on.
const TESTED: usize = 500;
/// Regular positions are as good if their variance exceeds that of the plan by at most this share.
const ALIKE: f64 = 0.02;
/// Width of the image in print, millimetres.
const WIDTH_MM: f64 = 120.0;

#[derive(Debug, Args)]
#[command(after_help = "\
Selects one candidate after another. Each lowers the variance of a Gaussian process, summed over the
region, most. Prints random, regular and largest-variance choices of the same size beside the plan.
Writes plan.csv (order, candidate, position, mean variance so far) and plan.png.
CANDIDATES
  SOURCE alone           the positions of a data folder, none of them measured yet
  --candidates, --floor  new positions; those of SOURCE (data, run folder or model) are measured
LENGTH SCALE
  A fifth of the diagonal of the region, without measurements. Measured data with new candidates, and
  --simulate at 8 positions and at every doubling, estimate it by maximum likelihood.

EXAMPLES
  pwrfgs plan data/s23 --simulate --count 100 --out next
  pwrfgs plan data/mine --candidates new.csv --count 20 --out next
  pwrfgs plan --floor scenes/office.ron --step 0.25 --height 1.2 --count 20 --out next")]
pub(crate) struct Plan {
    #[command(flatten)]
    pub(crate) places: PlaceOptions,
    /// Number of positions to select
    #[arg(long, value_name = "N")]
    pub(crate) count: usize,
    /// Extent in x and y of the region to predict, metres [default: all candidates]
    #[arg(long, value_name = "X0,X1,Y0,Y1", allow_hyphen_values = true)]
    pub(crate) region: Option<String>,
    /// Learn the length scale from the selected measurements of the data folder
    #[arg(long, requires = "source", conflicts_with_all = ["candidates", "floor", "length_scale"])]
    pub(crate) simulate: bool,
    /// Length scale in metres, not learned
    #[arg(long, value_name = "M")]
    pub(crate) length_scale: Option<f64>,
    /// Random seed of the random choice
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Output folder; must be new or empty
    #[arg(long, value_name = "DIR", default_value = "plan")]
    pub(crate) out: PathBuf,
}

/// Runs `pwrfgs plan`: prints the plan and other choices, and writes its list and map.
pub(crate) fn plan(arguments: &Plan, verbosity: Verbosity) -> Result<()> {
    let stop = stop_flag();
    let places = RunProgress::observe(verbosity, |progress| read_places(&arguments.places, progress))?;
    let total = places.candidates.len();
    check_count(arguments.count, total)?;
    let region = select_region(arguments, &places)?;
    let survey = Survey::new(&places.candidates, &region, &places.measured);
    let start = first_correlation(arguments, &places, &region)?;
    let folder = NewFolder::begin(&arguments.out)?;
    let learn = |order: &[usize]| {
        places.data.as_ref().filter(|_| arguments.simulate).and_then(|data| learn_correlation(data, order))
    };
    let plan = RunProgress::observe(verbosity, |progress| {
        staged(progress, "selecting positions", |progress| {
            survey.select(start, arguments.count, learn, |done| {
                progress(done, arguments.count);
                !stop.load(Ordering::Relaxed)
            })
        })
    });
    check_stopped(&stop)?;
    let mut choices = list_choices(&survey, &plan, arguments.seed);
    let gain = RunProgress::observe(verbosity, |progress| score_choices(&mut choices, &places, progress))?;
    write_files(&folder, &places, &plan, &choices[0].variances)?;
    folder.publish()?;
    output::print_result(&format_table(&choices, gain, &plan.correlation, &places))?;
    verbosity.print_note(&format!("{} positions in {}", grouped(plan.order.len() as i64), arguments.out.display()));
    Ok(())
}

/// Rejects a number of positions that is 0 or larger than `total`, that of the candidates.
fn check_count(count: usize, total: usize) -> Result<()> {
    if (1..=total).contains(&count) {
        return Ok(());
    }
    let problem = if count == 0 {
        "give at least 1".to_owned()
    } else {
        format!("there are {} candidates; lower --count, or give more candidates", grouped(total as i64))
    };
    Err(Error::Config(format!("--count {count}: {problem}")))
}

/// Returns the candidates in the region of `--region`, all without it; an error if it has none.
fn select_region(arguments: &Plan, places: &Places) -> Result<Vec<[f64; 3]>> {
    let Some(text) = &arguments.region else { return Ok(places.thinned_candidates(|_| true)) };
    let bounds = PlaneBounds::parse("--region", text, ["x", "y"])?;
    let region = places.thinned_candidates(|[x, y, _]| bounds.has_point([x, y]));
    if region.is_empty() {
        let [(x0, x1), (y0, y1)] =
            [0, 1].map(|k| statistics::bounds(places.candidates.iter().map(|position| position[k])));
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

/// Returns the correlation of the first step: of `--length-scale`, else learned from known measurements, else the
/// default of the region.
fn first_correlation(arguments: &Plan, places: &Places, region: &[[f64; 3]]) -> Result<Correlation> {
    let default = default_correlation(region);
    if let Some(length) = arguments.length_scale {
        if !(1e-6..=1e8).contains(&length) {
            return Err(Error::Config(format!("--length-scale {length}: expected metres, more than 0, such as 0.5")));
        }
        return Ok(Correlation { scales: [length, length, length, f64::INFINITY], ..default });
    }
    let measured = places.data.as_ref().filter(|_| !places.measured.is_empty());
    let learned = measured.and_then(|data| learn_correlation(data, &(0..data.locations.len()).collect::<Vec<_>>()));
    Ok(learned.unwrap_or(default))
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

/// Scores Kriging from each choice on transmitters in none of them. Returns the gain of the plan over the regular
/// choice; `None` without measured candidates or without such transmitters.
fn score_choices(choices: &mut [Choice], places: &Places, progress: &mut RunProgress) -> Result<Option<Difference>> {
    let Some(data) = places.data.as_ref().filter(|_| places.measured.is_empty()) else { return Ok(None) };
    let test = test_links(data, choices);
    if test.is_empty() {
        return Ok(None);
    }
    let (stop, total) = (stop_flag(), choices.len());
    for (k, choice) in choices.iter_mut().enumerate() {
        check_stopped(&stop)?;
        progress.on_stage("scoring", k, total);
        choice.scores = kriging_scores(data, &choice.order, &test)?;
    }
    progress.remove_bar();
    Ok(mean_gain(data, &test, &choices[0], &choices[1]))
}

/// Computes the mean gain of the scores of the plan over the regular choice, with an interval over blocks of positions,
/// since neighbours and the links of one transmitter are not independent. `test` are the scored links.
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
    let left: Vec<usize> = (0..is_taken.len()).filter(|&j| !is_taken[j]).collect();
    data.links_of(&evenly(&left, TESTED))
}

/// Writes `plan.csv` and `plan.png` into `folder`; `variances` are those before and after each position.
fn write_files(folder: &NewFolder, places: &Places, plan: &SurveyPlan, variances: &[f64]) -> Result<()> {
    let mut lines = Lines::new(["order", "candidate", "x", "y", "z", "mean_variance"]);
    for (k, &j) in plan.order.iter().enumerate() {
        let [x, y, z] = places.candidates[j].map(|v| v.to_string());
        let [order, candidate] = [k + 1, j + 1].map(|v| v.to_string());
        lines.put([&order, &candidate, &x, &y, &z, &format!("{:.6}", variances[k + 1])]);
    }
    let flat = |[x, y, _]: &[f64; 3]| [*x, *y];
    let map = SurveyMap {
        title: format!("{}: {} positions to measure", places.title, grouped(plan.order.len() as i64)),
        candidates: places.candidates.iter().map(flat).collect(),
        known: places.measured.iter().map(flat).collect(),
        selected: plan.order.iter().map(|&j| flat(&places.candidates[j])).collect(),
        receivers: places.receivers.iter().map(flat).collect(),
    };
    folder.put("plan.csv", lines.text())?;
    folder.put("plan.png", map.draw().png(WIDTH_MM))
}

/// Formats the table of the choices, with the correlation and a comparison with the regular choice.
fn format_table(choices: &[Choice], gain: Option<Difference>, correlation: &Correlation, places: &Places) -> String {
    let task = places.data.as_ref().map(Dataset::task).filter(|_| !choices[0].scores.is_empty());
    let mut header = vec!["choice".to_owned(), "mean variance".into()];
    header.extend(task.map(|task| format!("{} of Kriging", task.headline.name)));
    let mut lines = vec![header];
    for choice in choices {
        let mut line = vec![choice.name.clone(), fixed(choice.final_variance(), 4)];
        line.extend(task.map(|_| fixed(mean(choice.scores.iter().copied()), 4)));
        lines.push(line);
    }
    let Correlation { scales: [length, ..], noise, .. } = correlation;
    let mut text = aligned(&lines, 1);
    _ = write!(
        text,
        "\n{} candidates, {} known measurements; exponential correlation, length scale {} m, noise {} of the variance\n",
        grouped(places.candidates.len() as i64),
        grouped(places.measured.len() as i64),
        number(*length),
        number(*noise)
    );
    if let Some(task) = task {
        let (test, data) = (grouped(choices[0].scores.len() as i64), places.simulated_prefix());
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

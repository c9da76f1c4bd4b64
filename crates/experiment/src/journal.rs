//! `Journal`: what a training writes as it goes: `curve.csv`, `validation.csv` and, where asked for, TensorBoard events.

use crate::events::{Events, TEST};
use crate::folder::{CURVE, EVENTS, RunFolder, VALIDATION};
use crate::observer::Validation;
use crate::scores::ScoreTable;
use crate::series::Series;
use pwrfgs_core::{Result, Task};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::StepReport;

/// Up to this many steps every one has its row in `curve.csv`, beyond every tenth.
const DENSE_STEPS: u64 = 2_000;
/// Header of `curve.csv`.
const CURVE_HEADER: &str = "step,phase,loss,penalty,gaussians,seconds";

/// The open files.
#[derive(Debug)]
pub(crate) struct Journal {
    curve: Series,
    looks: Series,
    events: Option<Events>,
    steps: u64,
    seconds: f64,
}

impl Journal {
    /// Opens the files, cut back to step `done`.
    pub(crate) fn open(folder: &RunFolder, pipeline: &Pipeline, task: Task, done: u64) -> Result<Self> {
        let (curve, last) = Series::open(&folder.file(CURVE), CURVE_HEADER, done)?;
        let (looks, _) =
            Series::open(&folder.file(VALIDATION), &format!("step,{}", task.headline.columns.join(",")), done)?;
        let events = pipeline.tensorboard.then(|| Events::open(&folder.file(EVENTS), done)).transpose()?;
        let seconds = last.and_then(|row| row.rsplit(',').next().and_then(|s| s.parse().ok())).unwrap_or_default();
        Ok(Self { curve, looks, events, steps: pipeline.training.steps, seconds })
    }

    /// Seconds inside training steps, all starts together.
    pub(crate) fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Notes a step that took `seconds`.
    pub(crate) fn step(&mut self, report: &StepReport, seconds: f64) -> Result<()> {
        self.seconds += seconds;
        let (StepReport { step, phase, loss, penalty, gaussians, .. }, seconds) = (report, self.seconds);
        if !has_row(*step, self.steps) {
            return Ok(());
        }
        self.curve.push(&format!("{step},{},{loss},{penalty},{gaussians},{seconds:.3}", phase.name()))?;
        self.scalars(*step, &[("loss", *loss), ("penalty", *penalty), ("gaussians", *gaussians as f64)])
    }

    /// Notes a look at the validation part.
    pub(crate) fn validation(&mut self, seen: &Validation) -> Result<()> {
        let Validation { step, values: [mean, median, third], .. } = seen;
        self.looks.push(&format!("{step},{mean},{median},{third}"))?;
        let names = seen.task.headline.columns.map(|column| format!("validation/{column}"));
        let scalars: Vec<(&str, f64)> = names.iter().map(String::as_str).zip(seen.values).collect();
        self.scalars(seen.step, &scalars)
    }

    /// Brings all of it to the disk; called before each checkpoint, which must never know more.
    pub(crate) fn sync(&self) -> Result<()> {
        self.curve.sync()?;
        self.looks.sync()?;
        self.events.as_ref().map_or(Ok(()), Events::sync)
    }

    fn scalars(&mut self, step: u64, scalars: &[(&str, f64)]) -> Result<()> {
        self.events.as_mut().map_or(Ok(()), |events| events.push(step, scalars))
    }
}

/// Adds what the model reached on the test part to the events: the mean of each metric, at the last step.
pub(crate) fn note_scores(folder: &RunFolder, steps: u64, scores: &ScoreTable) -> Result<()> {
    let mean = |row: &crate::scores::MetricRow| {
        let value = row.cells.first()?.numbers().first().copied()?;
        Some((format!("{TEST}{}", row.key), value))
    };
    let scalars: Vec<(String, f64)> = scores.metrics.iter().filter_map(mean).collect();
    let mut events = Events::open(&folder.file(EVENTS), steps)?;
    events.push(steps, &scalars)?;
    events.sync()
}

/// Whether `step` has a row in `curve.csv`: a function of the step alone, so that a resumed run writes the same rows.
fn has_row(step: u64, steps: u64) -> bool {
    steps <= DENSE_STEPS || step == 1 || step == steps || step.is_multiple_of(10)
}

#[cfg(test)]
mod tests {
    use super::has_row;

    #[test]
    fn rows_depend_on_the_step_alone() {
        assert!((1..=2000).all(|step| has_row(step, 2000)));
        let sparse: Vec<u64> = (1..=2001).filter(|&s| has_row(s, 2001)).collect();
        assert_eq!((sparse[0], sparse[1], *sparse.last().unwrap(), sparse.len()), (1, 10, 2001, 202));
    }
}

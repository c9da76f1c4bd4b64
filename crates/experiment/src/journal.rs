//! `Journal`: files written during training: `curve.csv`, `validation.csv` and optional TensorBoard events.

use crate::events::Events;
use crate::folder::{CURVE, CURVE_HEADER, EVENTS, VALIDATION};
use crate::run_folder::RunFolder;
use crate::scores::ScoreTable;
use crate::session::Validation;
use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::{Error, Result, Task};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::StepReport;
use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Number of steps up to which `curve.csv` has a row for each; longer trainings have every tenth.
const DENSE_STEPS: u64 = 2_000;
/// Prefix of the tags of `validation.csv` in TensorBoard.
const VALIDATION_PREFIX: &str = "validation/";

/// The open files.
#[derive(Debug)]
pub(crate) struct Journal {
    curve: Series,
    validation_series: Series,
    events: Option<Events>,
    steps: u64,
    seconds: f64,
}

impl Journal {
    /// Opens the files of a run in `folder`, truncated to step `done`, and writes the events of these steps again. `task`
    /// determines the columns of validations.
    ///
    /// # Errors
    /// A damaged file, or [`Error::Write`].
    pub(crate) fn open(folder: &RunFolder, pipeline: &Pipeline, task: Task, done: u64) -> Result<Self> {
        let (curve, rows) = Series::open(&folder.file(CURVE), CURVE_HEADER, done)?;
        let columns = format!("step,{}", task.headline.columns.join(","));
        let (validation_series, validations) = Series::open(&folder.file(VALIDATION), &columns, done)?;
        let seconds = rows.last().map_or(0.0, |row| parse_seconds(row));
        let mut journal = Self { curve, validation_series, events: None, steps: pipeline.training.steps, seconds };
        if pipeline.tensorboard {
            journal.events = Some(Events::create(&folder.file(EVENTS))?);
            journal.replay_events(&rows, &validations)?;
        }
        Ok(journal)
    }

    /// Rewrites the events of earlier rows, in their original order.
    fn replay_events(&mut self, rows: &[String], validations: &[String]) -> Result<()> {
        let of_curve = rows.iter().map(|row| (parse_step(row), "", &self.curve.header, row));
        let of_validations =
            validations.iter().map(|row| (parse_step(row), VALIDATION_PREFIX, &self.validation_series.header, row));
        let mut events: Vec<_> = of_curve.chain(of_validations).collect();
        events.sort_by_key(|(step, ..)| *step);
        // A validation has no time: that of the last row of the curve applies.
        let mut ago = 0.0;
        for (step, prefix, header, row) in events {
            if prefix.is_empty() {
                ago = self.seconds - parse_seconds(row);
            }
            self.events.as_mut().map_or(Ok(()), |file| file.push(step, &named_values(prefix, header, row), ago))?;
        }
        Ok(())
    }

    /// Returns the seconds inside training steps, summed over all starts.
    pub(crate) fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Adds the `seconds` of a step to the total, and writes its row if `curve.csv` has one for it.
    pub(crate) fn record_step(&mut self, report: &StepReport, seconds: f64) -> Result<()> {
        self.seconds += seconds;
        let StepReport { step, phase, loss, penalty, gaussians, .. } = report;
        if !has_curve_row(*step, self.steps) {
            return Ok(());
        }
        let row = format!("{step},{},{loss},{penalty},{gaussians},{:.3}", phase.name(), self.seconds);
        self.curve.push(&row)?;
        self.events
            .as_mut()
            .map_or(Ok(()), |events| events.push(*step, &named_values("", &self.curve.header, &row), 0.0))
    }

    /// Writes the row of a validation.
    pub(crate) fn record_validation(&mut self, validation: &Validation) -> Result<()> {
        let Validation { step, values: [mean, median, third], .. } = validation;
        let row = format!("{step},{mean},{median},{third}");
        self.validation_series.push(&row)?;
        self.events.as_mut().map_or(Ok(()), |events| {
            events.push(*step, &named_values(VALIDATION_PREFIX, &self.validation_series.header, &row), 0.0)
        })
    }

    /// Records the mean of each metric of the model on the test set, at the last step, for TensorBoard.
    pub(crate) fn record_scores(&mut self, scores: &ScoreTable) -> Result<()> {
        let mean = |row: &crate::scores::MetricRow| {
            let value = row.cells.first()?.numbers().first().copied()?;
            Some((format!("test/{}", row.key), value))
        };
        let scalars: Vec<(String, f64)> = scores.metrics.iter().filter_map(mean).collect();
        self.events.as_mut().map_or(Ok(()), |events| events.push(self.steps, &scalars, 0.0))?;
        self.sync()
    }

    /// Flushes all files to disk; called before each checkpoint, which must never be ahead of them.
    pub(crate) fn sync(&self) -> Result<()> {
        self.curve.sync()?;
        self.validation_series.sync()?;
        self.events.as_ref().map_or(Ok(()), Events::sync)
    }
}

/// Parses the first field of a row, the step; 0 if it is not an integer.
fn parse_step(row: &str) -> u64 {
    row.split(',').next().and_then(|step| step.parse().ok()).unwrap_or(0)
}

/// Parses the last field of a row of `curve.csv`, the seconds; 0 if it is not a number.
fn parse_seconds(row: &str) -> f64 {
    row.rsplit(',').next().and_then(|seconds| seconds.parse().ok()).unwrap_or(0.0)
}

/// Names the values of a row by `prefix` and column, without step, phase, seconds, and fields that are not numbers.
fn named_values(prefix: &str, header: &str, row: &str) -> Vec<(String, f64)> {
    let named = header.split(',').zip(row.split(',')).filter(|(name, _)| !["step", "phase", "seconds"].contains(name));
    named.filter_map(|(name, value)| Some((format!("{prefix}{name}"), value.parse().ok()?))).collect()
}

/// Returns whether `step` of a training of `steps` has a row in `curve.csv`. Depends only on these numbers, so that a
/// resumed run writes the same rows.
fn has_curve_row(step: u64, steps: u64) -> bool {
    steps <= DENSE_STEPS || step == 1 || step == steps || step.is_multiple_of(10)
}

/// Open CSV file; the first field of each row is the step.
#[derive(Debug)]
struct Series {
    path: PathBuf,
    header: String,
    file: File,
}

impl Series {
    /// Opens `path` and returns the rows up to step `done`. Later rows are dropped: rows of later steps, and incomplete
    /// rows of a killed run.
    ///
    /// # Errors
    /// The header, or a row before the last kept one, is damaged: its data would be lost silently. The file cannot be read or
    /// written.
    fn open(path: &Path, header: &str, done: u64) -> Result<(Self, Vec<String>)> {
        let old = files::if_found(path, files::read(path))?.unwrap_or_default();
        let old = String::from_utf8_lossy(&old);
        let mut text = format!("{header}\n");
        let (mut rows, mut broken) = (Vec::new(), None);
        let damaged = |line: usize, problem: &str| {
            Error::at(path, line, 1, format!("{problem}; repair the file, or remove it to resume without its rows"))
        };
        let mut lines = old.split_inclusive('\n').zip(1..);
        if done > 0 && lines.next().is_some_and(|(first, _)| first != text) {
            return Err(damaged(1, &format!("the first line is not `{header}`")));
        }
        for (line, number) in lines {
            match line.split(',').next().and_then(|step| step.parse::<u64>().ok()) {
                Some(step) if step <= done && line.ends_with('\n') => {
                    if let Some(number) = broken {
                        return Err(damaged(number, "this row does not begin with a step, but rows follow"));
                    }
                    text.push_str(line);
                    rows.push(line.trim_end().to_owned());
                }
                Some(_) => {}
                None => broken = broken.or(Some(number)),
            }
        }
        write_atomically(path, text.as_bytes())?;
        let file = OpenOptions::new().append(true).open(path).map_err(|e| Error::write(path, e))?;
        Ok((Self { path: path.into(), header: header.into(), file }, rows))
    }

    /// Appends one row.
    fn push(&mut self, row: &str) -> Result<()> {
        self.file.write_all(format!("{row}\n").as_bytes()).map_err(|e| Error::write(&self.path, e))
    }

    /// Flushes the rows to disk; called before each checkpoint, which must never be ahead of them.
    fn sync(&self) -> Result<()> {
        self.file.sync_data().map_err(|e| Error::write(&self.path, e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{read_series, read_whole_series};

    #[test]
    fn journal_rows_depend_on_step_only() {
        assert!((1..=2000).all(|step| has_curve_row(step, 2000)));
        let sparse: Vec<u64> = (1..=2001).filter(|&s| has_curve_row(s, 2001)).collect();
        assert_eq!((sparse[0], sparse[1], *sparse.last().unwrap(), sparse.len()), (1, 10, 2001, 202));
    }

    #[test]
    fn series_is_truncated_to_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("curve.csv");
        let (mut series, rows) = Series::open(&path, "step,loss", 0).unwrap();
        assert!(rows.is_empty());
        for row in ["10,0.5", "20,0.4", "30,0.3"] {
            series.push(row).unwrap();
        }
        series.file.write_all(b"40,0.").unwrap();
        let (mut series, rows) = Series::open(&path, "step,loss", 20).unwrap();
        assert_eq!(rows, ["10,0.5", "20,0.4"]);
        series.push("30,0.3").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "step,loss\n10,0.5\n20,0.4\n30,0.3\n");
        assert_eq!(read_series(&path)[2], vec![Some(30.0), Some(0.3)]);
        assert_eq!(read_whole_series(&path, 30).unwrap(), read_series(&path));
    }

    #[test]
    fn reports_damaged_row_before_checkpoint_only() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("curve.csv");
        let open = |text: &[u8], done| {
            std::fs::write(&path, text).unwrap();
            Series::open(&path, "step,loss", done).map(|(_, rows)| rows).map_err(|e| e.to_string())
        };
        assert_eq!(open(b"step,loss\n10,0.5\n\0\xff\0\n", 20), Ok(vec!["10,0.5".into()]));
        assert_eq!(open(b"stop,loss\n10,0.5\n", 0), Ok(vec![]), "nothing is kept");
        let message = open(b"step,loss\n1\xff0,0.5\n20,0.4\n", 20).unwrap_err();
        assert!(message.contains("curve.csv:2:1: this row does not begin with a step"), "{message}");
        let message = open(b"stop,loss\n10,0.5\n", 20).unwrap_err();
        assert!(message.contains("curve.csv:1:1: the first line is not `step,loss`; repair the file"), "{message}");
    }
}

//! Progress of a run: a bar on a terminal, else a plain line every few seconds.

use crate::interrupt::InterruptibleRun;
use crate::output::{self, Verbosity, print_note, progress_bars};
use indicatif::{ProgressBar, ProgressState, ProgressStyle};
use pwrfgs::experiment::text::{format_duration, format_gigabytes, grouped};
use pwrfgs::experiment::{Observer, Start, Validation};
use pwrfgs::train::StepReport;
use std::collections::VecDeque;
use std::fmt::Write as _;
use std::io::IsTerminal as _;
use std::time::{Duration, Instant};

/// Interval between two redraws of the bar.
const REDRAW: Duration = Duration::from_millis(100);
/// Interval between two plain lines.
const LINE: Duration = Duration::from_secs(5);
/// Interval between two plain lines of one of several runs.
const LINE_OF_SEVERAL: Duration = Duration::from_secs(30);
/// Period over which the speed is averaged.
const WINDOW: Duration = Duration::from_secs(20);

/// Shortest stage that is shown; also the interval at which its seconds are redrawn.
const PATIENCE: Duration = Duration::from_secs(1);

/// Observer that shows the progress of a run.
#[derive(Debug)]
pub(crate) struct RunProgress {
    verbosity: Verbosity,
    /// Name of the run, if there are several.
    name: Option<String>,
    bar: Option<ProgressBar>,
    /// Number of training steps.
    steps: u64,
    /// Times and numbers of recent steps that were shown.
    pace: VecDeque<(Instant, u64)>,
    /// Time of the last update of the bar or plain line.
    shown: Instant,
    /// Running mean of the training loss.
    loss: f64,
    validation: Option<Validation>,
    /// Start of the current stage.
    stage: Instant,
    /// Guard that lets a training finish its step after Ctrl-C; `None` in other stages.
    training: Option<InterruptibleRun>,
}

impl RunProgress {
    /// Creates the observer of a single run.
    pub(crate) fn new(verbosity: Verbosity) -> Self {
        let (pace, now) = (VecDeque::new(), Instant::now());
        Self {
            verbosity,
            name: None,
            bar: None,
            steps: 0,
            pace,
            shown: now,
            loss: f64::NAN,
            validation: None,
            stage: now,
            training: None,
        }
    }

    /// Runs `work` with an observer of a single run, whose bar is then removed; returns the result of `work`.
    pub(crate) fn observe<R>(verbosity: Verbosity, work: impl FnOnce(&mut Self) -> R) -> R {
        work(&mut Self::new(verbosity))
    }

    /// Creates the observer of the run `name`, one of several.
    pub(crate) fn of_run(name: &str, verbosity: Verbosity) -> Self {
        let mut progress = Self::new(verbosity);
        progress.name = Some(name.to_owned());
        progress
    }

    /// Returns the interval between two plain lines, longer for one of several runs.
    fn line_interval(&self) -> Duration {
        if self.name.is_some() { LINE_OF_SEVERAL } else { LINE }
    }

    /// Prints a plain line, with the name of the run if there are several.
    fn print_line(&self, line: &str) {
        match &self.name {
            Some(name) => print_note(&format!("{name}: {line}")),
            None => print_note(line),
        }
    }

    /// Replaces the bar by one of `length` steps; without a new one if the output is quiet or stderr is no terminal.
    fn draw_bar(&mut self, length: u64) {
        let style = ProgressStyle::with_template("{prefix}{bar:24.cyan/dim} {pos}/{len}  {msg}")
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("━╸─");
        self.replace_bar(ProgressBar::new(length).with_style(style));
    }

    /// Replaces the bar by the name of a stage and its seconds so far, shown once they exceed [`PATIENCE`].
    fn draw_waiting(&mut self, name: &str) {
        let name = name.to_owned();
        let words = move |state: &ProgressState, text: &mut dyn std::fmt::Write| {
            if state.elapsed() > PATIENCE {
                _ = write!(text, "{name}  {}", format_duration(state.elapsed().as_secs_f64()));
            }
        };
        let style =
            ProgressStyle::with_template("{prefix}{words}").unwrap_or_else(|_| ProgressStyle::default_spinner());
        self.replace_bar(ProgressBar::no_length().with_style(style.with_key("words", words)));
    }

    /// Replaces the bar by `bar`; without a new one if the output is quiet or stderr is no terminal.
    fn replace_bar(&mut self, bar: ProgressBar) {
        self.remove_bar();
        if self.verbosity != Verbosity::Quiet && std::io::stderr().is_terminal() {
            let prefix = self.name.as_ref().map_or_else(String::new, |name| format!("{name}  "));
            let bar = progress_bars().add(bar.with_prefix(prefix));
            bar.enable_steady_tick(PATIENCE);
            self.bar = Some(bar);
        }
    }

    /// Removes the bar, if there is one.
    pub(crate) fn remove_bar(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
            progress_bars().remove(&bar);
        }
    }

    /// Computes the steps per second over about the last [`WINDOW`]; `None` until two steps were shown.
    fn steps_per_second(&self) -> Option<f64> {
        let ((then, from), (now, to)) = (self.pace.front()?, self.pace.back()?);
        let seconds = (*now - *then).as_secs_f64();
        (seconds > 0.0).then(|| (to - from) as f64 / seconds)
    }

    /// Describes a training step: phase, loss, N, last validation, speed and remaining time.
    fn describe_step(&self, report: &StepReport) -> String {
        let mut words = format!("{:<8}  loss {:.4}", report.phase.name(), self.loss);
        if report.gaussians > 0 {
            _ = write!(words, "  N {}", grouped(report.gaussians as i64));
        }
        if let Some(v) = self.validation {
            let [mean, ..] = v.values;
            _ = write!(words, "  validation {} {mean:.3}", v.task.headline.name);
        }
        if let Some(speed) = self.steps_per_second() {
            let left = format_duration((self.steps - report.step) as f64 / speed);
            let _ = if speed >= 1.0 {
                write!(words, "  {speed:.1} it/s  {left} left")
            } else {
                write!(words, "  {:.1} s/it  {left} left", 1.0 / speed)
            };
        }
        words
    }
}

impl Drop for RunProgress {
    fn drop(&mut self) {
        self.remove_bar();
    }
}

impl Observer for RunProgress {
    fn on_stage(&mut self, name: &str, done: usize, total: usize) {
        self.training = None;
        let now = Instant::now();
        if done == 0 || done >= total {
            self.remove_bar();
            (self.stage, self.shown) = (now, now);
            if done == 0 {
                self.draw_waiting(name);
            }
        } else if now - self.stage > PATIENCE {
            let is_terminal = std::io::stderr().is_terminal();
            if self.bar.as_ref().is_none_or(|bar| bar.length().is_none()) {
                self.draw_bar(total as u64);
            }
            let left = format_duration((now - self.stage).as_secs_f64() / done as f64 * (total - done) as f64);
            if let Some(bar) = &self.bar {
                bar.set_message(format!("{name}  {left} left"));
                bar.set_position(done as u64);
            } else if !is_terminal && self.verbosity != Verbosity::Quiet && now - self.shown >= self.line_interval() {
                self.shown = now;
                let (done, total) = (grouped(done as i64), grouped(total as i64));
                self.print_line(&format!("{name}: {done} of {total}  {left} left"));
            }
        }
    }

    fn on_start(&mut self, start: &Start<'_>) {
        self.training = Some(InterruptibleRun::begin());
        if self.verbosity == Verbosity::Quiet {
            return;
        }
        let [train, validation, test] = start.samples.map(|n| grouped(n as i64));
        if self.name.is_none() {
            let things = start.task.counted[1];
            print_note(&format!("{}: {train} training, {validation} validation, {test} test {things}", start.title));
        }
        let action = if start.done > 0 {
            format!("resuming after step {} of", grouped(start.done as i64))
        } else {
            "training".into()
        };
        let steps = grouped(start.steps as i64);
        match &self.name {
            None => print_note(&format!("{action} {steps} steps in {}", start.folder.display())),
            Some(_) => self.print_line(&format!("{action} {steps} steps")),
        }
        let memory = format_gigabytes(start.step_bytes);
        self.print_line(&match start.gaussians {
            0 => format!("about {memory} per step"),
            n => format!("N = {}, about {memory} per step", grouped(n as i64)),
        });
        self.steps = start.steps;
        self.pace.clear();
        (self.loss, self.validation) = (f64::NAN, None); // of the member before
        self.draw_bar(start.steps);
        if let Some(bar) = &self.bar {
            bar.set_position(start.done);
        }
    }

    fn on_step(&mut self, report: &StepReport) {
        // A mean over about 20 steps.
        self.loss = if self.loss.is_nan() { report.loss } else { 0.95 * self.loss + 0.05 * report.loss };
        let now = Instant::now();
        let interval = if self.bar.is_some() { REDRAW } else { self.line_interval() };
        // Always shows the first and the last step, unless there are several runs.
        let is_edge = (self.pace.is_empty() || report.step == self.steps) && self.name.is_none();
        if !is_edge && now - self.shown < interval {
            return;
        }
        self.shown = now;
        self.pace.push_back((now, report.step));
        while self.pace.len() > 2 && self.pace.front().is_some_and(|(then, _)| now - *then > WINDOW) {
            self.pace.pop_front();
        }
        if let Some(bar) = &self.bar {
            bar.set_position(report.step);
            bar.set_message(self.describe_step(report));
        } else if self.verbosity != Verbosity::Quiet {
            self.print_line(&format!("step {}/{}  {}", report.step, self.steps, self.describe_step(report)));
        }
    }

    fn on_validation(&mut self, validation: &Validation) {
        self.validation = Some(*validation);
        if self.verbosity == Verbosity::Verbose {
            let [mean, median, third] = validation.values;
            let headline = validation.task.headline;
            self.print_line(&format!(
                "step {}: validation {} {mean:.4} (median {median:.4}), {} {third:.4}",
                validation.step, headline.name, headline.columns[2]
            ));
        }
    }

    fn on_message(&mut self, message: &str) {
        self.training = None; // training is over, scoring follows
        if self.verbosity != Verbosity::Quiet && (self.name.is_none() || self.verbosity == Verbosity::Verbose) {
            self.remove_bar();
            self.print_line(message);
        }
    }

    fn on_warning(&mut self, warning: &str) {
        self.remove_bar();
        output::print_warning(warning);
    }
}

//! `pwrfgs sweep`: runs an experiment.

mod progress;

use super::options::ChangeOptions;
use super::run::format_scores;
use crate::interrupt::stop_flag;
use crate::output::{self, FAILED, INTERRUPTED, SUCCESS, Verbosity};
use crate::program;
use crate::progress::RunProgress;
use clap::Args;
use progress::{SweepProgress, has_failed};
use pwrfgs::experiment::folder::REPORT;
use pwrfgs::experiment::sweep::{JOINED, RunStage, SweepEnd, SweepPlan, check, estimate_run_seconds, run_pool, slurm};
use pwrfgs::experiment::{RunOutcome, Session};
use pwrfgs_core::device::{self, DeviceChoice};
use pwrfgs_core::threads::parse_count;
use pwrfgs_core::{Error, Result, ShippedFile};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

#[derive(Debug, Args)]
#[command(after_help = "\
An experiment file names a base pipeline, seeds, and axes whose variants change settings. All runs
are validated before the first run starts. The total time is estimated, unless the runs are short.
Repeat the command to resume: it continues interrupted runs, skips finished runs and repeats failed
runs. After the last run, it writes tables and figures to the folder report in the sweep folder. If
the file sets `join: true`, it writes an ensemble of all models to the folder joined.
docs/guide.md explains the file; `pwrfgs pipelines` also lists the experiments in the program.

ON A CLUSTER
  --launcher slurm submits a job array, one task per run, with the resources of `slurm` in the file.
  Other schedulers: start the command n times on a shared disk, with --shard 1/n to --shard n/n.

EXAMPLES
  pwrfgs sweep paper-office --dry-run
  pwrfgs sweep paper-office --jobs 2
  pwrfgs sweep experiments/splits.ron --set 'data=Nerf2Spectrum(root: \"data/s23\")' --out runs/s23")]
#[allow(clippy::struct_excessive_bools)] // options of the command line
pub(crate) struct Sweep {
    /// Experiment file, or name in `pwrfgs pipelines`
    #[arg(value_name = "EXPERIMENT")]
    pub(crate) experiment: PathBuf,
    #[command(flatten)]
    pub(crate) changes: ChangeOptions,
    /// Sweep folder [default: runs/NAME, from the name of the experiment]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// List all runs with estimated times; run nothing
    #[arg(long)]
    pub(crate) dry_run: bool,
    /// Print the progress of each run, also of runs on other machines; run nothing
    #[arg(long, conflicts_with = "dry_run")]
    pub(crate) status: bool,
    /// Number of parallel runs, which share the threads
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = parse_count)]
    pub(crate) jobs: usize,
    /// Run only part I of N of the runs, such as 2/5, for any scheduler
    #[arg(long, value_name = "I/N", value_parser = parse_shard)]
    pub(crate) shard: Option<Shard>,
    /// Run only the runs with these parts of the folder name, such as seed=0 or method=masks,seed=0
    #[arg(long, value_name = "PARTS", conflicts_with = "shard")]
    pub(crate) only: Option<String>,
    /// Keep the training state of finished runs, checkpoint.safetensors
    #[arg(long)]
    pub(crate) keep_checkpoint: bool,
    /// Print all metrics of the ensemble of all models, if the experiment sets `join: true`
    #[arg(long)]
    pub(crate) all: bool,
    /// Submit the runs to a scheduler and return; NAME is slurm
    #[arg(long, value_name = "NAME", hide_possible_values = true, conflicts_with_all = ["dry_run", "status"])]
    pub(crate) launcher: Option<Launcher>,
}

/// Scheduler that runs are submitted to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Launcher {
    /// Slurm job array, submitted with `sbatch`
    Slurm,
}

/// Part `index` of `count`, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shard {
    pub(crate) index: usize,
    pub(crate) count: usize,
}

/// Parses `2/5`, the value of `--shard`.
fn parse_shard(text: &str) -> Result<Shard, String> {
    let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    match parts {
        Some((index, count)) if (1..=count).contains(&index) => Ok(Shard { index, count }),
        _ => Err("expected i/n with 1 <= i <= n, such as 2/5".into()),
    }
}

/// Runs `pwrfgs sweep`: prints the progress or the estimates, submits the runs, or executes them; returns the exit
/// code. `threads` is the value of `--threads`.
pub(crate) fn sweep(arguments: &Sweep, threads: Option<usize>, verbosity: Verbosity) -> Result<u8> {
    let plan = SweepPlan::read(&arguments.experiment, &arguments.changes.assignments(), arguments.out.as_deref())?;
    let runs = select_runs(&plan, arguments)?;
    if arguments.status {
        output::print_result(&plan.progress_table(&runs, &queued_runs(&plan)))?;
        return Ok(SUCCESS);
    }
    let (jobs, available) = (arguments.jobs, rayon::current_num_threads());
    if jobs > available {
        let problem = format!("more than the {available} available threads; set at most {available}");
        return Err(Error::Config(format!("--jobs {jobs}: {problem}")));
    }
    let (keep_checkpoint, all) = (arguments.keep_checkpoint, arguments.all);
    let selected = SelectedRuns { plan: &plan, indices: &runs, jobs, keep_checkpoint, all, verbosity };
    if arguments.dry_run {
        return selected.print_estimates();
    }
    if let Some(Launcher::Slurm) = arguments.launcher {
        let open = RunProgress::observe(verbosity, |progress| check(&plan, &runs, progress))?;
        return submit_runs(&plan, &open, arguments, threads);
    }
    selected.announce()?;
    selected.execute(None)
}

/// Least number of training steps per combination for an estimate, which takes up to 80 steps.
const WORTH_STEPS: u64 = 1_600;

/// Runs of a sweep that a command lists or executes.
#[derive(Clone, Copy)]
pub(super) struct SelectedRuns<'a> {
    pub(super) plan: &'a SweepPlan,
    /// Indices of the runs in the plan.
    pub(super) indices: &'a [usize],
    /// Number of parallel runs.
    pub(super) jobs: usize,
    /// Whether finished runs keep their checkpoints.
    pub(super) keep_checkpoint: bool,
    /// Whether the scores of the ensemble of all models have all metrics.
    pub(super) all: bool,
    pub(super) verbosity: Verbosity,
}

impl SelectedRuns<'_> {
    /// Validates the runs. Also prints their estimated total time, unless the output is quiet or the estimate would
    /// take long compared with the runs.
    pub(super) fn announce(self) -> Result<()> {
        let Self { plan, indices, jobs, verbosity, .. } = self;
        let steps: u64 = indices.iter().map(|run| plan.runs[*run].pipeline.training.steps).sum();
        let combinations = indices.iter().map(|run| plan.runs[*run].combination).collect::<BTreeSet<_>>().len() as u64;
        if verbosity == Verbosity::Quiet || steps < WORTH_STEPS * combinations {
            return RunProgress::observe(verbosity, |progress| check(plan, indices, progress)).map(drop);
        }
        let seconds = self.estimate_seconds()?;
        if seconds.iter().any(|seconds| *seconds > 0.0) {
            output::print_note(plan.describe_total(indices, &seconds, jobs).trim_end());
        }
        Ok(())
    }

    /// Validates the runs and estimates the seconds of each.
    fn estimate_seconds(self) -> Result<Vec<f64>> {
        let pool = run_pool(self.jobs)?;
        RunProgress::observe(self.verbosity, |progress| {
            pool.install(|| estimate_run_seconds(self.plan, self.indices, progress))
        })
    }

    /// Prints all runs with estimated times; returns the exit code.
    pub(super) fn print_estimates(self) -> Result<u8> {
        let seconds = self.estimate_seconds()?;
        output::print_result(&self.plan.estimate_table(self.indices, &seconds, self.jobs))?;
        Ok(SUCCESS)
    }

    /// Executes the runs in this process and prints their table; returns the exit code. The process that ends the last
    /// run of the sweep writes the report, whose paired differences are against `reference`.
    pub(super) fn execute(self, reference: Option<&str>) -> Result<u8> {
        let Self { plan, indices, jobs, keep_checkpoint, all, verbosity } = self;
        let stop = stop_flag();
        let progress = SweepProgress::new(plan, indices.len(), verbosity);
        let end = RunProgress::observe(verbosity, |observer| {
            let mut session = Session { observer, stop: &stop, page: pwrfgs::PAGE, keep_checkpoint };
            plan.execute(indices, jobs, &progress, &mut session)
        });
        progress.remove_bar();
        #[cfg(feature = "report")]
        let has_ended = stop.load(Ordering::Relaxed) || plan.has_ended();
        #[cfg(feature = "report")]
        let reported = if !stop.load(Ordering::Relaxed) && has_ended {
            // If the last runs of two processes end together, one writes after the other.
            plan.claim().and_then(|_held| super::report::report_sweep(&plan.folder, reference, verbosity))
        } else {
            Ok(())
        };
        let SweepEnd { runs: ends, joined } = end?;
        #[cfg(feature = "report")]
        reported?;
        output::print_result(&plan.progress_table(indices, &queued_runs(plan)))?;
        print_ensemble(plan, joined, all)?;
        #[cfg(feature = "report")]
        if !has_ended && ends.iter().any(|(_, end)| matches!(end, Ok(RunOutcome::Finished { .. }))) {
            let (folder, total) = (plan.folder.display(), plan.runs.len());
            verbosity.print_note(&format!(
                "the sweep has {total} runs, and its report follows the last; for those so far: pwrfgs report {folder}"
            ));
        }
        Ok(self.print_end(&ends, stop.load(Ordering::Relaxed)))
    }

    /// Prints a note if runs failed or were stopped; returns the exit code. `ends` are the runs with their results.
    fn print_end(self, ends: &[(usize, Result<RunOutcome>)], is_stopped: bool) -> u8 {
        let failed = ends.iter().filter(|(_, end)| has_failed(end)).count();
        if failed > 0 {
            let (total, failures) = (self.indices.len(), self.plan.folder.join("failures"));
            output::print_note(&format!(
                "{failed} of {total} runs failed; see the errors above and in {}; repeat the command to retry them",
                failures.display()
            ));
            return FAILED;
        }
        if is_stopped {
            output::print_note("stopped; repeat the command to resume");
            return INTERRUPTED;
        }
        SUCCESS
    }
}

/// Prints the scores of the ensemble of all models, if the sweep has one.
fn print_ensemble(plan: &SweepPlan, joined: Option<RunOutcome>, all: bool) -> Result<()> {
    let Some(RunOutcome::Finished { scores, .. }) = joined else { return Ok(()) };
    let folder = plan.folder.join(JOINED);
    let report = pwrfgs::PAGE.map(|_| format!("\nreport: {}\n", folder.join(REPORT).display()));
    let head = format!("\nensemble of {} models in {}\n", plan.runs.len(), folder.display());
    output::print_result(&(head + &format_scores(&scores, all) + &report.unwrap_or_default()))
}

/// Lists the folders of the runs in the Slurm queue; empty, with a note, if it cannot be read.
fn queued_runs(plan: &SweepPlan) -> BTreeSet<String> {
    slurm::queued_runs(plan).unwrap_or_else(|error| {
        output::print_note(&format!("note: {error}"));
        BTreeSet::new()
    })
}

/// Returns the indices in the plan of the runs that `--shard` or `--only` select; all without them.
fn select_runs(plan: &SweepPlan, arguments: &Sweep) -> Result<Vec<usize>> {
    if let Some(name) = &arguments.only {
        return plan.find_runs(name);
    }
    let Shard { index, count } = arguments.shard.unwrap_or(Shard { index: 1, count: 1 });
    Ok((0..plan.runs.len()).filter(|run| run % count == index - 1).collect())
}

/// Submits to Slurm the `unfinished` runs that are not running or queued; returns the exit code.
fn submit_runs(plan: &SweepPlan, unfinished: &[usize], arguments: &Sweep, threads: Option<usize>) -> Result<u8> {
    let _held = plan.claim()?; // no other process may submit the same runs meanwhile
    let queued = slurm::queued_runs(plan)?;
    let is_free = |run: &usize| {
        !queued.contains(&plan.runs[*run].folder) && !matches!(plan.state(*run), RunStage::Running { .. })
    };
    let runs: Vec<usize> = unfinished.iter().copied().filter(is_free).collect();
    let waiting = unfinished.len() - runs.len();
    if runs.is_empty() {
        output::print_result(&format!(
            "nothing to submit: {waiting} runs are queued or running, the others are finished\n"
        ))?;
        return Ok(SUCCESS);
    }
    let command = task_command(plan, arguments, threads.unwrap_or(plan.slurm.cpus))?;
    let (job, script) = slurm::submit(plan, &runs, &command)?;
    output::print_result(&format!(
        "submitted {} runs as job {job} ({})\nprogress: repeat the command with --status instead of --launcher\n",
        runs.len(),
        script.display()
    ))?;
    Ok(SUCCESS)
}

/// Creates the command line of a task of a Slurm job, as words; the name of its run must follow.
fn task_command(plan: &SweepPlan, arguments: &Sweep, threads: usize) -> Result<Vec<String>> {
    let text = |path: &Path| {
        std::path::absolute(path).map(|path| path.display().to_string()).map_err(|e| Error::read(path, e))
    };
    let program = program::path()?;
    let current =
        std::env::current_dir().map_err(|e| Error::Config(format!("cannot read the current directory: {e}")))?;
    // Paths in --set are relative to the current directory, also in a task.
    let mut words = vec!["env".into(), format!("--chdir={}", text(&current)?)];
    if device::choice() != DeviceChoice::Cpu {
        words.push(format!("{}={}", device::VARIABLE, device::choice()));
    }
    words.extend([text(&program)?, "sweep".into()]);
    let shipped = ShippedFile::find(ShippedFile::EXPERIMENTS, Path::new(""), &arguments.experiment);
    let experiment = shipped.map_or_else(|| text(&arguments.experiment), |file| Ok(file.name.into()))?;
    words.extend([experiment, "--out".into(), text(&plan.folder)?]);
    words.extend(arguments.changes.assignments().into_iter().flat_map(|set| ["--set".into(), set]));
    words.extend(arguments.keep_checkpoint.then(|| "--keep-checkpoint".into()));
    words.extend(["--threads".into(), threads.to_string(), "--quiet".into(), "--only".into()]);
    Ok(words)
}

#[cfg(test)]
mod tests {
    use super::{Shard, parse_shard};

    #[test]
    fn parses_shard_index_and_count() {
        assert_eq!(parse_shard("2/5"), Ok(Shard { index: 2, count: 5 }));
        for wrong in ["0/5", "6/5", "2", "a/b", "1/0", "-1/2"] {
            assert!(parse_shard(wrong).is_err(), "{wrong}");
        }
    }
}

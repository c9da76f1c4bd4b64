//! `pwrfgs sweep`: an experiment becomes a folder of runs.

mod table;

use super::options::{Changes, count};
use crate::interrupt::{INTERRUPTED, stop_flag};
use crate::output::{self, Verbosity};
use crate::progress::Progress;
use clap::Args;
use pwrfgs::experiment::folder::REPORT;
use pwrfgs::experiment::sweep::{JOINED, Plan, State, SweepEnd, check, estimate, execute, pool, slurm};
use pwrfgs::experiment::{Outcome, Session};
use pwrfgs_core::{Error, Result};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use table::Table;

#[derive(Debug, Args)]
#[command(
    after_long_help = "An experiment names a base pipeline, seeds, and axes whose variants change some of its values by their path:\n\n  \
    Experiment(\n      name: \"lambda\", base: \"../pipelines/quickstart.ron\", seeds: [0, 1, 2],\n      axes: [Axis(name: \
    \"lambda\", variants: [\n          (label: \"0.01\", set: {\"pruners\": [LearnableMask(lambda: 0.01)]}),\n          (label: \
    \"0.02\", set: {\"pruners\": [LearnableMask(lambda: 0.02)]}),\n      ])],\n  )\n\nAll combinations are tried before the first \
    starts. Every run has its own folder, as `pwrfgs run` makes it. The same command does what is left: finished runs \
    are skipped, stopped and killed ones go on from their checkpoints, failed ones are tried again. In the end it \
    writes tables and figures into DIR/report.\n\nWith `join: true` in the file the models of all runs become one in DIR/joined, an \
    ensemble: it predicts their mean, and confidence.csv says how far they differ and how wrong their mean is.\n\nON A CLUSTER\n  --launcher slurm submits a job array, one task a run, with \
    the resources of `slurm: (cpus: 4, memory: \"8G\", time: \"02:00:00\")` in the file; --status says how far they are. \
    With any other scheduler start the same command n times on a shared disk, with --shard 1/n to --shard n/n.\n\nEXAMPLES\n  \
    pwrfgs sweep experiments/lambda.ron --dry-run\n  pwrfgs sweep experiments/lambda.ron --jobs 2\n  pwrfgs sweep \
    experiments/lambda.ron --set 'data=Nerf2Spectrum(root: \"data/s23\")' --out runs/lambda-s23"
)]
pub(crate) struct Sweep {
    /// The experiment file
    #[arg(value_name = "EXPERIMENT")]
    pub(crate) experiment: PathBuf,
    #[command(flatten)]
    pub(crate) changes: Changes,
    /// The sweep folder [default: runs/NAME, after the name of the experiment]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// List all runs and how long they would take here; run nothing
    #[arg(long)]
    pub(crate) dry_run: bool,
    /// Say how far each run is, wherever it runs; run nothing
    #[arg(long, conflicts_with = "dry_run")]
    pub(crate) status: bool,
    /// Runs at a time; they share the threads
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = count)]
    pub(crate) jobs: usize,
    /// Do the i-th of n parts only, for any scheduler
    #[arg(long, value_name = "I/N", value_parser = shard)]
    pub(crate) shard: Option<Shard>,
    /// Do this run only, named as its folder
    #[arg(long, value_name = "RUN", conflicts_with = "shard")]
    pub(crate) only: Option<String>,
    /// Hand the runs to a scheduler and come back at once
    #[arg(long, value_name = "NAME", conflicts_with_all = ["dry_run", "status"])]
    pub(crate) launcher: Option<Launcher>,
}

/// A scheduler that is spoken to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Launcher {
    /// A job array of `sbatch`
    Slurm,
}

/// The `index`-th of `count` parts, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shard {
    pub(crate) index: usize,
    pub(crate) count: usize,
}

/// `2/5`.
fn shard(text: &str) -> Result<Shard, String> {
    let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    match parts {
        Some((index, count)) if (1..=count).contains(&index) => Ok(Shard { index, count }),
        _ => Err("write it as i/n with 1 <= i <= n, such as 2/5".into()),
    }
}

pub(crate) fn sweep(arguments: &Sweep, threads: Option<usize>, verbosity: Verbosity) -> Result<ExitCode> {
    let plan = Plan::read(&arguments.experiment, &arguments.changes.all(), arguments.out.as_deref())?;
    let runs = chosen(&plan, arguments)?;
    if arguments.status {
        output::result(&table::status(&plan, &runs, &queued_or_note(&plan)))?;
        return Ok(ExitCode::SUCCESS);
    }
    let threads_there = rayon::current_num_threads();
    if arguments.jobs > threads_there {
        return Err(Error::Config(format!(
            "--jobs {}: there are {threads_there} threads, and a run needs one; give at most {threads_there}",
            arguments.jobs
        )));
    }
    if arguments.dry_run {
        return dry_run(&plan, &runs, arguments.jobs, verbosity);
    }
    let open = Progress::during(verbosity, |progress| check(&plan, &runs, progress))?;
    match arguments.launcher {
        Some(Launcher::Slurm) => submit(&plan, &open, arguments, threads),
        None => here(&plan, &runs, arguments.jobs, verbosity),
    }
}

/// What Slurm has, where it tells; the folders tell all else without it.
fn queued_or_note(plan: &Plan) -> BTreeSet<String> {
    slurm::queued(plan).unwrap_or_else(|error| {
        output::note(&format!("note: {error}"));
        BTreeSet::new()
    })
}

/// The runs that `--shard` or `--only` name; all without them.
fn chosen(plan: &Plan, arguments: &Sweep) -> Result<Vec<usize>> {
    if let Some(name) = &arguments.only {
        return Ok(vec![plan.find(name)?]);
    }
    let Shard { index, count } = arguments.shard.unwrap_or(Shard { index: 1, count: 1 });
    Ok((0..plan.runs.len()).filter(|run| run % count == index - 1).collect())
}

/// All runs in this process.
fn here(plan: &Plan, runs: &[usize], jobs: usize, verbosity: Verbosity) -> Result<ExitCode> {
    let stop = stop_flag();
    let board = Table::new(plan, runs.len(), verbosity);
    let end = Progress::during(verbosity, |progress| {
        let mut session = Session { observer: progress, stop: &stop, page: pwrfgs::PAGE };
        execute(plan, runs, jobs, &board, &mut session)
    });
    board.finish();
    let SweepEnd { runs: ends, joined } = end?;
    #[cfg(feature = "report")]
    if plan.states().iter().all(|state| matches!(state, State::Finished(_))) {
        let _held = plan.claim()?; // of two processes whose last runs end at once, one writes after the other
        super::report::of_sweep(&plan.folder, verbosity)?;
    }
    let failed = ends.iter().filter(|(_, end)| end.as_ref().is_err_and(|e| !matches!(e, Error::Busy(_)))).count();
    output::result(&table::status(plan, runs, &queued_or_note(plan)))?;
    if let Some(Outcome::Finished { scores, .. }) = joined {
        let folder = plan.folder.join(JOINED);
        let report = pwrfgs::PAGE.map(|_| format!("\nreport: {}\n", folder.join(REPORT).display()));
        let head = format!("\njoined model of {} runs, in {}\n", plan.runs.len(), folder.display());
        output::result(&(head + &scores.to_text() + &report.unwrap_or_default()))?;
    }
    if failed > 0 {
        output::note(&format!(
            "{failed} of {} runs failed; the reasons stand above and in {}; the same command tries them again",
            runs.len(),
            plan.folder.join("failures").display()
        ));
        return Ok(ExitCode::from(1));
    }
    if stop.load(Ordering::Relaxed) {
        output::note("stopped; the same command goes on");
        return Ok(ExitCode::from(INTERRUPTED));
    }
    Ok(ExitCode::SUCCESS)
}

/// Lists all runs with the time they would take.
fn dry_run(plan: &Plan, runs: &[usize], jobs: usize, verbosity: Verbosity) -> Result<ExitCode> {
    let pool = pool(jobs)?;
    let seconds = Progress::during(verbosity, |progress| pool.install(|| estimate(plan, runs, progress)))?;
    output::result(&table::plan(plan, runs, &seconds, jobs))?;
    Ok(ExitCode::SUCCESS)
}

/// Hands the runs to Slurm that are neither done, nor at work, nor in its queue already.
fn submit(plan: &Plan, open: &[usize], arguments: &Sweep, threads: Option<usize>) -> Result<ExitCode> {
    let _held = plan.claim()?; // what is asked for here must not be submitted by another process meanwhile
    let queued = slurm::queued(plan)?;
    let free =
        |run: &usize| !queued.contains(&plan.runs[*run].folder) && !matches!(plan.state(*run), State::Running { .. });
    let runs: Vec<usize> = open.iter().copied().filter(free).collect();
    let waiting = open.len() - runs.len();
    if runs.is_empty() {
        output::result(&format!("nothing to submit: {waiting} runs are with Slurm, the others have finished\n"))?;
        return Ok(ExitCode::SUCCESS);
    }
    let command = task_command(plan, arguments, threads.unwrap_or(plan.slurm.cpus))?;
    let (job, script) = slurm::submit(plan, &runs, &command)?;
    output::result(&format!(
        "submitted {} runs as job {job} ({})\nhow far they are: the same command with --status in place of --launcher\n",
        runs.len(),
        script.display()
    ))?;
    Ok(ExitCode::SUCCESS)
}

/// What a task calls; the name of its run comes last.
fn task_command(plan: &Plan, arguments: &Sweep, threads: usize) -> Result<Vec<String>> {
    let text = |path: &std::path::Path| {
        std::path::absolute(path).map(|path| path.display().to_string()).map_err(|e| Error::read(path, e))
    };
    let program = std::env::current_exe().map_err(|e| Error::Config(format!("where is this program? {e}")))?;
    let here = std::env::current_dir().map_err(|e| Error::Config(format!("where are we? {e}")))?;
    // Paths in --set are relative to where one stands, also in a task.
    let mut words = vec!["env".into(), format!("--chdir={}", text(&here)?), text(&program)?, "sweep".into()];
    words.extend([text(&arguments.experiment)?, "--out".into(), text(&plan.folder)?]);
    words.extend(arguments.changes.all().into_iter().flat_map(|set| ["--set".into(), set]));
    words.extend(["--threads".into(), threads.to_string(), "--quiet".into(), "--only".into()]);
    Ok(words)
}

#[cfg(test)]
mod tests {
    use super::{Shard, shard};

    #[test]
    fn a_shard_is_a_part_of_a_whole() {
        assert_eq!(shard("2/5"), Ok(Shard { index: 2, count: 5 }));
        for wrong in ["0/5", "6/5", "2", "a/b", "1/0", "-1/2"] {
            assert!(shard(wrong).is_err(), "{wrong}");
        }
    }
}

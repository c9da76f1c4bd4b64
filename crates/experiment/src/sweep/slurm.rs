//! Submission of the runs of a sweep to Slurm: one job array, one task per run.
//!
//! Each submission has a folder `slurm/1`, `slurm/2`, .. in the sweep folder: the script for `sbatch`, the list of runs
//! of its tasks, the job id, and one log per task. Tasks read their run from that list, so changes of the experiment do
//! not affect waiting tasks.

use super::plan::SweepPlan;
use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::{Error, Result};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Folder with one numbered folder per submission, relative to the sweep folder.
const FOLDER: &str = "slurm";
/// Script of the job array, in the folder of a submission.
const SCRIPT: &str = "sweep.sh";
/// Run names, one per line: line k is task k.
const RUNS: &str = "runs.txt";
/// Job id.
const JOB: &str = "job.txt";

/// Writes and submits a job array for `runs`; `command` is the program with all arguments of a task except the run
/// name, which is appended. Returns the job id and the script. Lock the sweep folder ([`SweepPlan::claim`]) for both
/// [`queued_runs`] and `submit`, so that no other process submits the same runs.
///
/// # Errors
/// The folder cannot be written, or `sbatch` is missing or fails.
pub fn submit(plan: &SweepPlan, runs: &[usize], command: &[String]) -> Result<(String, PathBuf)> {
    let folder = create_submission(plan)?;
    let names: String = runs.iter().map(|&run| plan.runs[run].folder.clone() + "\n").collect();
    write_atomically(&folder.join(RUNS), names.as_bytes())?;
    let path = folder.join(SCRIPT);
    write_atomically(&path, format_script(plan, runs.len(), command, &folder)?.as_bytes())?;
    let output = Command::new("sbatch").arg("--parsable").arg(&path).output().map_err(|e| {
        Error::Config(format!("cannot call sbatch ({e}); use a machine with Slurm, or omit --launcher"))
    })?;
    let message = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    if !output.status.success() {
        let why = String::from_utf8_lossy(&output.stderr).trim().to_owned();
        return Err(Error::Config(format!(
            "sbatch refused {}: {why}; change `slurm` in the experiment file (a larger array than the cluster allows is \
             cut with --shard)",
            path.display()
        )));
    }
    let job = message.split(';').next().unwrap_or_default().to_owned();
    write_atomically(&folder.join(JOB), format!("{job}\n").as_bytes())?;
    Ok((job, path))
}

/// Lists the folders of the runs in Slurm's queue, waiting or running; empty without submissions.
///
/// # Errors
/// Slurm does not respond: waiting runs would be submitted twice.
pub fn queued_runs(plan: &SweepPlan) -> Result<BTreeSet<String>> {
    let jobs: Vec<(String, Vec<String>)> = list_submissions(plan)
        .into_iter()
        .filter_map(|(_, folder)| {
            let read = |name: &str| files::read_string(folder.join(name)).ok();
            Some((read(JOB)?.trim().to_owned(), read(RUNS)?.lines().map(str::to_owned).collect()))
        })
        .collect();
    let mut names = BTreeSet::new();
    // One call per job: squeue fails for all jobs if one is unknown to it.
    for (job, runs) in &jobs {
        names.extend(queued_tasks(job)?.into_iter().filter_map(|task: usize| runs.get(task.wrapping_sub(1)).cloned()));
    }
    Ok(names)
}

/// Lists the numbers, from 1, of the tasks of `job` that wait or run.
fn queued_tasks(job: &str) -> Result<Vec<usize>> {
    // Without completing tasks: these have ended, and Slurm only removes their processes.
    let states = "--states=PENDING,CONFIGURING,RUNNING,SUSPENDED";
    let output = Command::new("squeue")
        .args(["--noheader", "--array", "--format=%K", states, "--jobs", job])
        .output()
        .map_err(|e| Error::Config(format!("cannot call squeue ({e}); use a machine with Slurm")))?;
    let message = String::from_utf8_lossy(&output.stderr);
    // Unknown jobs have ended some minutes ago.
    if !output.status.success() && !message.contains("Invalid job id") {
        return Err(Error::Config(format!("cannot read the Slurm queue: {}; try again", message.trim())));
    }
    let numbers = String::from_utf8_lossy(&output.stdout).lines().filter_map(|l| l.trim().parse().ok()).collect();
    Ok(numbers)
}

/// Creates the folder of one more submission and returns its absolute path; the lock of the sweep folder prevents
/// collisions.
fn create_submission(plan: &SweepPlan) -> Result<PathBuf> {
    let number = list_submissions(plan).last().map_or(1, |(number, _)| number + 1);
    let folder = std::path::absolute(&plan.folder).map_err(|e| Error::read(&plan.folder, e))?;
    let submission = folder.join(FOLDER).join(number.to_string());
    std::fs::create_dir_all(&submission).map_err(|e| Error::write(&submission, e))?;
    Ok(submission)
}

/// Lists the numbers and folders of the earlier submissions, ascending.
fn list_submissions(plan: &SweepPlan) -> Vec<(u32, PathBuf)> {
    let entries = std::fs::read_dir(plan.folder.join(FOLDER)).into_iter().flatten().flatten();
    let mut submissions: Vec<(u32, PathBuf)> =
        entries.filter_map(|e| Some((e.file_name().to_str()?.parse().ok()?, e.path()))).collect();
    submissions.sort();
    submissions
}

/// Lists the `sbatch` options of a job array of `tasks` tasks, whose files are in `folder`.
fn sbatch_options(plan: &SweepPlan, tasks: usize, folder: &Path) -> Vec<String> {
    let slurm = &plan.slurm;
    let at_once = slurm.at_once.map_or_else(String::new, |n| format!("%{n}"));
    let mut options = vec![
        format!("--job-name={}", plan.name),
        format!("--array=1-{tasks}{at_once}"),
        // Slurm expands `%` in the whole path.
        format!("--output={}/%a.log", folder.display().to_string().replace('%', "%%")),
        "--open-mode=append".into(),
        "--requeue".into(),
        // To the script only, a minute before the time limit; not the signal of scancel, which must not requeue.
        "--signal=B:USR1@60".into(),
        format!("--cpus-per-task={}", slurm.cpus),
        format!("--mem={}", slurm.memory),
        format!("--time={}", slurm.time),
    ];
    options.extend(slurm.partition.as_ref().map(|p| format!("--partition={p}")));
    options.extend(slurm.account.as_ref().map(|a| format!("--account={a}")));
    options.extend(slurm.options.iter().cloned());
    options
}

/// Formats the script of a job array of `tasks` tasks, which run `command`; their files are in `folder`.
///
/// # Errors
/// An option with a quote, newline or backslash, which `#SBATCH` lines cannot hold.
fn format_script(plan: &SweepPlan, tasks: usize, command: &[String], folder: &Path) -> Result<String> {
    let mut text = format!("#!/bin/bash\n# {} runs of the sweep `{}`, one task per run.\n", tasks, plan.name);
    for option in &sbatch_options(plan, tasks, folder) {
        if option.contains(['"', '\n', '\\']) {
            let problem = "contains a quote, newline or backslash; change the run folder or `slurm`";
            return Err(Error::Config(format!("sbatch option `{option}` {problem}")));
        }
        _ = writeln!(text, "#SBATCH \"{option}\"");
    }
    let command = command.iter().map(|word| shell_quoted(word)).collect::<Vec<_>>().join(" ");
    let runs = shell_quoted(&folder.join(RUNS).display().to_string());
    _ = write!(
        text,
        "\n\
         # Shortly before the time limit: back into the queue. Slurm then asks every process of the task to end; the run\n\
         # writes its checkpoint, and its next start resumes from it.\n\
         # (Not by SLURM_JOB_ID: for the task that starts last that is the id of the whole array.)\n\
         trap 'scontrol requeue \"${{SLURM_ARRAY_JOB_ID}}_${{SLURM_ARRAY_TASK_ID}}\"; interrupted=yes' USR1\n\
         # Slurm signals the run itself; this script must outlive it.\n\
         trap 'interrupted=yes' TERM\n\
         {}\
         run=$(sed -n \"${{SLURM_ARRAY_TASK_ID}}p\" {runs})\n\
         {command} \"$run\" &\n\
         while interrupted=; wait $!; code=$?; [ -n \"$interrupted\" ]; do :; done\n\
         exit $code\n",
        plan.slurm.setup.iter().fold(String::new(), |lines, line| lines + line + "\n")
    );
    Ok(text)
}

/// Quotes a word for a shell with single quotes.
fn shell_quoted(word: &str) -> String {
    format!("'{}'", word.replace('\'', r"'\''"))
}

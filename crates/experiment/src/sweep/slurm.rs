//! Handing the runs of a sweep to Slurm: one job array, one task a run.
//!
//! Each submission has a folder `slurm/1`, `slurm/2`, .. below the sweep folder: the script as `sbatch` read it, the list
//! of runs that its tasks do, its job id, and a log a task. A task names its run by that list, so that a change of the
//! experiment does not change what waiting tasks do.

use super::plan::Plan;
use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::{Error, Result};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

const FOLDER: &str = "slurm";
const SCRIPT: &str = "sweep.sh";
const RUNS: &str = "runs.txt";
const JOB: &str = "job.txt";

/// Writes and submits a job array for `runs`; `command` is the program with all arguments of one task but the run's name,
/// which comes last. Returns the job id and the script. Whoever asks [`queued`] first and then submits holds the sweep
/// folder ([`Plan::claim`]) for both, so that nobody else submits the same.
///
/// # Errors
/// Where the folder cannot be written, or `sbatch` is missing or refuses.
pub fn submit(plan: &Plan, runs: &[usize], command: &[String]) -> Result<(String, PathBuf)> {
    let own = new_submission(plan)?;
    let names: String = runs.iter().map(|&run| plan.runs[run].folder.clone() + "\n").collect();
    write_atomically(&own.join(RUNS), names.as_bytes())?;
    let path = own.join(SCRIPT);
    write_atomically(&path, script(plan, runs.len(), command, &own)?.as_bytes())?;
    let output = Command::new("sbatch").arg("--parsable").arg(&path).output().map_err(|e| {
        Error::Config(format!("cannot call sbatch ({e}); go to a machine where Slurm is, or leave --launcher away"))
    })?;
    let said = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    if !output.status.success() {
        let why = String::from_utf8_lossy(&output.stderr).trim().to_owned();
        return Err(Error::Config(format!(
            "sbatch refused {}: {why}; change `slurm` in the experiment file (a larger array than the cluster allows is \
             cut with --shard)",
            path.display()
        )));
    }
    let job = said.split(';').next().unwrap_or_default().to_owned();
    write_atomically(&own.join(JOB), format!("{job}\n").as_bytes())?;
    Ok((job, path))
}

/// The folders of the runs that wait or run in Slurm's queue; none where nothing was submitted.
///
/// # Errors
/// Where Slurm does not answer: then a run that waits would pass for one that does not.
pub fn queued(plan: &Plan) -> Result<BTreeSet<String>> {
    let jobs: Vec<(String, Vec<String>)> = submissions(plan)
        .into_iter()
        .filter_map(|(_, own)| {
            let read = |name: &str| files::read_string(own.join(name)).ok();
            Some((read(JOB)?.trim().to_owned(), read(RUNS)?.lines().map(str::to_owned).collect()))
        })
        .collect();
    let mut names = BTreeSet::new();
    // One call a job: squeue refuses them all where it has forgotten one.
    for (job, runs) in &jobs {
        names.extend(tasks(job)?.into_iter().filter_map(|task: usize| runs.get(task.wrapping_sub(1)).cloned()));
    }
    Ok(names)
}

/// Numbers, from 1, of the tasks of `job` that wait or run.
fn tasks(job: &str) -> Result<Vec<usize>> {
    // Without those that are completing: they have ended, and only their processes are cleared away.
    let states = "--states=PENDING,CONFIGURING,RUNNING,SUSPENDED";
    let output = Command::new("squeue")
        .args(["--noheader", "--array", "--format=%K", states, "--jobs", job])
        .output()
        .map_err(|e| Error::Config(format!("cannot call squeue ({e}); go to a machine where Slurm is")))?;
    let said = String::from_utf8_lossy(&output.stderr);
    // What it has forgotten has ended some minutes ago.
    if !output.status.success() && !said.contains("Invalid job id") {
        return Err(Error::Config(format!("Slurm does not tell what waits in its queue: {}; try again", said.trim())));
    }
    let numbers = String::from_utf8_lossy(&output.stdout).lines().filter_map(|l| l.trim().parse().ok()).collect();
    Ok(numbers)
}

/// A folder for one more submission; nobody else makes one while the sweep folder is held.
fn new_submission(plan: &Plan) -> Result<PathBuf> {
    let number = submissions(plan).last().map_or(1, |(number, _)| number + 1);
    let folder = std::path::absolute(&plan.folder).map_err(|e| Error::read(&plan.folder, e))?;
    let own = folder.join(FOLDER).join(number.to_string());
    std::fs::create_dir_all(&own).map_err(|e| Error::write(&own, e))?;
    Ok(own)
}

/// Earlier submissions by number.
fn submissions(plan: &Plan) -> Vec<(u32, PathBuf)> {
    let entries = std::fs::read_dir(plan.folder.join(FOLDER)).into_iter().flatten().flatten();
    let mut all: Vec<(u32, PathBuf)> =
        entries.filter_map(|e| Some((e.file_name().to_str()?.parse().ok()?, e.path()))).collect();
    all.sort();
    all
}

/// The script of a job array of `tasks` tasks.
fn script(plan: &Plan, tasks: usize, command: &[String], own: &Path) -> Result<String> {
    let slurm = &plan.slurm;
    let mut text = format!("#!/bin/bash\n# {} runs of the sweep `{}`, a task each.\n", tasks, plan.name);
    let at_once = slurm.at_once.map_or_else(String::new, |n| format!("%{n}"));
    let mut options = vec![
        format!("--job-name={}", plan.name),
        format!("--array=1-{tasks}{at_once}"),
        // Slurm expands `%` in the whole path.
        format!("--output={}/%a.log", own.display().to_string().replace('%', "%%")),
        "--open-mode=append".into(),
        "--requeue".into(),
        // To the script alone, a minute before the time limit; another signal than that of scancel, which must not requeue.
        "--signal=B:USR1@60".into(),
        format!("--cpus-per-task={}", slurm.cpus),
        format!("--mem={}", slurm.memory),
        format!("--time={}", slurm.time),
    ];
    options.extend(slurm.partition.as_ref().map(|p| format!("--partition={p}")));
    options.extend(slurm.account.as_ref().map(|a| format!("--account={a}")));
    options.extend(slurm.options.iter().cloned());
    for option in &options {
        if option.contains(['"', '\n', '\\']) {
            return Err(Error::Config(format!("`{option}` cannot stand in a script for sbatch; rename the folder")));
        }
        _ = writeln!(text, "#SBATCH \"{option}\"");
    }
    let command = command.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" ");
    let runs = quoted(&own.join(RUNS).display().to_string());
    _ = write!(
        text,
        "\n\
         # Shortly before the time limit: back into the queue. Slurm then asks every process of the task to end; the run\n\
         # writes its checkpoint, and its next start goes on from there.\n\
         # (Not by SLURM_JOB_ID: for the task that starts last that is the id of the whole array.)\n\
         trap 'scontrol requeue \"${{SLURM_ARRAY_JOB_ID}}_${{SLURM_ARRAY_TASK_ID}}\"; interrupted=yes' USR1\n\
         # The run hears of it from Slurm itself; this script must outlive it.\n\
         trap 'interrupted=yes' TERM\n\
         {}\
         run=$(sed -n \"${{SLURM_ARRAY_TASK_ID}}p\" {runs})\n\
         {command} \"$run\" &\n\
         while interrupted=; wait $!; code=$?; [ -n \"$interrupted\" ]; do :; done\n\
         exit $code\n",
        slurm.setup.iter().fold(String::new(), |lines, line| lines + line + "\n")
    );
    Ok(text)
}

/// A word for a shell.
fn quoted(word: &str) -> String {
    format!("'{}'", word.replace('\'', r"'\''"))
}

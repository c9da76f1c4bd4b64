//! What can be said on the command line. The help texts are the first documentation that a user meets.

use clap::{ArgAction, Args, Parser, Subcommand};
use std::path::PathBuf;

/// How much is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd)]
pub(crate) enum Verbosity {
    /// Errors and results.
    Quiet,
    /// Progress too.
    Normal,
    /// What happens inside too.
    Verbose,
}

#[derive(Debug, Parser)]
#[command(
    name = "pwrfgs",
    version,
    about = "Pruned 3D Gaussian splatting for wireless radiance fields",
    long_about = "Pruned 3D Gaussian splatting for wireless radiance fields (P-WRFGS).\n\nLearns, from spatial \
        spectra measured at known transmitter positions, a small set of Gaussians that predicts the spectrum of any \
        other position. An experiment is one RON file, a pipeline; a run of it is one folder.",
    after_long_help = "EXAMPLES\n  A first run, without any download, in about a minute:\n      pwrfgs run \
        pipelines/quickstart.ron\n  The same with other settings, elsewhere:\n      pwrfgs run pipelines/quickstart.ron \
        --set training.steps=500 --set seed=1 --out runs/short\n  What a transmitter at 1.2, 0.3, 1.0 m would be heard \
        from:\n      pwrfgs predict runs/quickstart/model.safetensors --tx 1.2,0.3,1.0 --out heard\n  Everything that a \
        pipeline may name:\n      pwrfgs plugins\n\nEXIT CODES\n  0 done, 1 failed, 2 wrong input, 130 interrupted \
        (the same command goes on)."
)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub(crate) command: Command,
    /// Threads to use [default: all processors]; results do not depend on it
    #[arg(long, global = true, value_name = "N", value_parser = count)]
    pub(crate) threads: Option<usize>,
    /// Say less: errors and results only
    #[arg(short, long, global = true, action = ArgAction::SetTrue, conflicts_with = "verbose")]
    quiet: bool,
    /// Say more: what happens inside
    #[arg(short, long, global = true, action = ArgAction::SetTrue)]
    verbose: bool,
}

/// A number of threads or jobs.
fn count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if (1..=1024).contains(&count) => Ok(count),
        _ => Err("give a number from 1 to 1024".into()),
    }
}

impl Arguments {
    pub(crate) fn verbosity(&self) -> Verbosity {
        match (self.quiet, self.verbose) {
            (true, _) => Verbosity::Quiet,
            (_, true) => Verbosity::Verbose,
            _ => Verbosity::Normal,
        }
    }
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Train, prune, evaluate and report: everything a pipeline says
    Run(Run),
    /// Run every combination of an experiment with every seed: an ablation
    Sweep(Sweep),
    /// Predict spectra for transmitter positions with a trained model
    Predict(Predict),
    /// Score a trained model, and the baselines beside it, on data of your choice
    Evaluate(Evaluate),
    /// Compare finished runs: tables and figures as Markdown, CSV, LaTeX and HTML
    Report(Report),
    /// Write a trained model for other programs: splat viewers, Python
    Export(Export),
    /// Simulate the spectra of a room that is known exactly, in the layout of measured data
    Simulate(Simulate),
    /// Show every plugin that a pipeline may name, with its fields and defaults
    Plugins(Plugins),
}

#[derive(Debug, Args)]
#[command(
    after_long_help = "The run folder holds pipeline.ron (every setting), curve.csv, validation.csv, scores.csv, \
    samples.csv, run.json, the checkpoint, model.safetensors and report.html; with --set tensorboard=true also \
    an event file, which `tensorboard --logdir runs` shows while the run goes on. The same command resumes a run that \
    was stopped or killed, and ends in the same files. A folder that holds anything else is never touched.\n\nPaths in \
    a pipeline are relative to its file; on the command line, to where you stand.\n\nEXAMPLES\n  pwrfgs run \
    pipelines/s23-laptop.ron --set 'data=Nerf2Spectrum(root: \"../shared/data/s23\")'\n  pwrfgs run \
    pipelines/pwrfgs.ron --set 'initializer=Random(count: 20_000, std: 10.0)' --out runs/fewer\n  pwrfgs run \
    runs/fewer/pipeline.ron --set seed=1 --out runs/fewer-1"
)]
pub(crate) struct Run {
    /// The pipeline file
    #[arg(value_name = "PIPELINE")]
    pub(crate) pipeline: PathBuf,
    /// Change a setting, such as training.steps=1000; a plugin is given whole, such as 'split=Random(test: 0.3)'
    #[arg(long = "set", value_name = "FIELD=VALUE")]
    pub(crate) set: Vec<String>,
    /// The run folder [default: runs/NAME, after the name of the pipeline]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

#[derive(Debug, Args)]
#[command(
    after_long_help = "An experiment names a base pipeline, seeds, and axes whose variants change some of its fields:\n\n  \
    Experiment(\n      name: \"lambda\", base: \"../pipelines/quickstart.ron\", seeds: [0, 1, 2],\n      axes: [Axis(name: \
    \"lambda\", variants: [\n          (label: \"0.01\", pruners: [LearnableMask(lambda: 0.01)]),\n          (label: \
    \"0.02\", pruners: [LearnableMask(lambda: 0.02)]),\n      ])],\n  )\n\nAll combinations are tried before the first \
    starts. Every run has its own folder, as `pwrfgs run` makes it. The same command does what is left: finished runs \
    are skipped, stopped and killed ones go on from their checkpoints, failed ones are tried again. In the end it \
    writes tables and figures into DIR/report.\n\nON A CLUSTER\n  --launcher slurm submits a job array, one task a run, with \
    the resources of `slurm: (cpus: 4, memory: \"8G\", time: \"02:00:00\")` in the file; --status says how far they are. \
    With any other scheduler start the same command n times on a shared disk, with --shard 1/n to --shard n/n.\n\nEXAMPLES\n  \
    pwrfgs sweep experiments/lambda.ron --dry-run\n  pwrfgs sweep experiments/lambda.ron --jobs 2\n  pwrfgs sweep \
    experiments/lambda.ron --set 'data=Nerf2Spectrum(root: \"data/s23\")' --out runs/lambda-s23"
)]
pub(crate) struct Sweep {
    /// The experiment file
    #[arg(value_name = "EXPERIMENT")]
    pub(crate) experiment: PathBuf,
    /// Change a setting of the base pipeline; what an axis says wins
    #[arg(long = "set", value_name = "FIELD=VALUE")]
    pub(crate) set: Vec<String>,
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

#[derive(Debug, Args)]
#[command(after_long_help = "Needs nothing but the model file. Writes, for the first position, 00001.npy (float32, \
    rows are elevation, columns azimuth) and 00001.png (8-bit grey), and so on, and predictions.csv with row, x, y, z, \
    strongest direction (azimuth and elevation in degrees), its value, and the milliseconds it took.\n\nSeveral models \
    predict as an ensemble: the mean of their pictures, each clamped to [0, 1]. How far they differ, the standard \
    deviation at every pixel, is then written beside, as 00001-spread.npy and .png (white is 0.5): do not trust a \
    picture where it is bright.\n\nEXAMPLES\n  pwrfgs predict runs/quickstart/model.safetensors --tx 1.2,0.3,1.0 --out \
    heard\n  pwrfgs predict runs/a-0/model.safetensors runs/a-1/model.safetensors --tx-csv positions.csv --out heard")]
#[command(group(clap::ArgGroup::new("where").required(true).args(["tx", "tx_csv"])))]
pub(crate) struct Predict {
    /// The trained model, model.safetensors of a run folder; several make an ensemble
    #[arg(value_name = "MODEL", required = true)]
    pub(crate) models: Vec<PathBuf>,
    /// One transmitter position in metres, world frame
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) tx: Option<String>,
    /// A CSV file with columns x, y, z in metres; others are ignored
    #[arg(long, value_name = "FILE")]
    pub(crate) tx_csv: Option<PathBuf>,
    /// The folder to write to; made where it is missing
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
}

#[derive(Debug, Args)]
#[command(
    after_long_help = "Reads the pipeline.ron that lies beside the model for data, split, metrics and baselines; \
    --set changes them. Prints the score table; with --out writes scores.csv, samples.csv and report.html.\n\nSeveral \
    models are scored as an ensemble: the mean of their pictures, each clamped to [0, 1]. Runs that differ in their seed \
    alone have the same test spectra unless the split is random; give those that do.\n\nEXAMPLES\
    \n  pwrfgs evaluate runs/s23/model.safetensors --set 'data=Nerf2Spectrum(root: \"data/other-day\")'\n  pwrfgs \
    evaluate runs/s23/model.safetensors --set 'metrics=[Ssim(), RateRatio(snr_db: 20.0)]' --out again\n  pwrfgs \
    evaluate runs/blocks/seed-0/model.safetensors runs/blocks/seed-1/model.safetensors"
)]
pub(crate) struct Evaluate {
    /// The trained model, model.safetensors of a run folder; several are scored as an ensemble
    #[arg(value_name = "MODEL", required = true)]
    pub(crate) models: Vec<PathBuf>,
    /// The pipeline file [default: pipeline.ron beside the first model]
    #[arg(long, value_name = "FILE")]
    pub(crate) pipeline: Option<PathBuf>,
    /// Change a setting, such as 'data=Nerf2Spectrum(root: "..")'
    #[arg(long = "set", value_name = "FIELD=VALUE")]
    pub(crate) set: Vec<String>,
    /// Where to write scores and report; nothing is written without it
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

#[derive(Debug, Args)]
#[command(
    after_long_help = "Runs on the same data and split form a setting, and are compared within it; those that differ in \
    their seed alone form a variant, and give a mean and a standard deviation. Writes report.html (one file), report.md, \
    report.csv (every number), report.tex with a file for each table (booktabs), and the figures as SVG and PNG. An \
    older report in the folder is replaced; a folder that holds anything else is never touched. Runs that have not \
    finished are named and left out.\n\nPaired differences from the reference carry a 95 % bootstrap interval over seeds \
    and blocks of space.\n\nEXAMPLES\n  pwrfgs report runs/lambda\n  pwrfgs report runs/cloud-0 runs/cloud-1 \
    runs/random-0 runs/random-1 --out compared\n  pwrfgs report runs/lambda --reference 5-NN"
)]
pub(crate) struct Report {
    /// Run folders, or folders of whole sweeps
    #[arg(value_name = "RUNS", required = true)]
    pub(crate) runs: Vec<PathBuf>,
    /// Where to write the report [default: report in the first of the folders]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// What paired differences are from: a variant as the table calls it, or a floor such as 5-NN [default: the first
    /// variant]
    #[arg(long, value_name = "LABEL")]
    pub(crate) reference: Option<String>,
}

#[derive(Debug, Args)]
#[command(
    after_long_help = "The PLY file has the binary layout of 3D Gaussian splatting, which splat viewers open: x y \
    z (metres, world frame), nx ny nz (0), f_dc_0..2 (colour), opacity (logit), scale_0..2 (ln of metres), rot_0..3 (w x \
    y z). The colour tells how strong the signal of a Gaussian is: the pixel it would give alone, were it opaque, from \
    dark violet at 0 to yellow at 1, the full scale of the spectra; f_dc = (rgb - 0.5) / 0.28209479177387814. The NPZ \
    file has the tensors of the model, the pose of the receiver and the image plane, as docs/model-format.md lists \
    them.\n\nThe deformation network changes scales, rotations and signals with the transmitter. Without --tx the PLY \
    file shows the base parameters, to which the network's terms are added (mid-grey where the network gives the whole \
    signal); with --tx it shows what is drawn for that transmitter, and the NPZ file has these numbers too.\n\nA file \
    that exists is never overwritten.\n\nEXAMPLES\n  pwrfgs export runs/quickstart/model.safetensors --ply office.ply\
    \n  pwrfgs export runs/quickstart/model.safetensors --tx 1.2,0.3,1.0 --ply office-at.ply --npz office-at.npz"
)]
#[command(group(clap::ArgGroup::new("what").required(true).multiple(true).args(["ply", "npz", "half"])))]
pub(crate) struct Export {
    /// The trained model, model.safetensors of a run folder
    #[arg(value_name = "MODEL")]
    pub(crate) model: PathBuf,
    /// The Gaussians for splat viewers
    #[arg(long, value_name = "FILE")]
    pub(crate) ply: Option<PathBuf>,
    /// All numbers of the model for numpy.load
    #[arg(long, value_name = "FILE")]
    pub(crate) npz: Option<PathBuf>,
    /// The model itself with its network in 16-bit numbers, about half as large
    #[arg(long, value_name = "FILE")]
    pub(crate) half: Option<PathBuf>,
    /// The Gaussians as they are for a transmitter at this position in metres, world frame
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) tx: Option<String>,
}

#[derive(Debug, Args)]
#[command(after_long_help = "Writes, in the layout of NeRF2: gateway_info.yml, tx_pos.csv, spectrum/00001.png .., \
    train_index.txt and test_index.txt (every fifth); and beside it power.csv (absolute path gain, for RSSI), paths.csv \
    (every path with gain, delay, angles and what it met), points.ply (points on all surfaces, with normals) and \
    manifest.json (every parameter). A folder that holds anything is never touched. In a pipeline, data: \
    Simulated(scene: ..) makes the same data set without this command.\n\nEXAMPLES\n  pwrfgs simulate \
    scenes/office.ron --out data/office\n  pwrfgs simulate scenes/lab-s23.ron --samples 4898 --no-paths --out data/lab")]
pub(crate) struct Simulate {
    /// The scene file
    #[arg(value_name = "SCENE")]
    pub(crate) scene: PathBuf,
    /// The folder to make
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// How many spectra
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub(crate) samples: usize,
    /// Which transmitter positions and receiver errors
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Points of the cloud
    #[arg(long, value_name = "N", default_value_t = 190_000)]
    pub(crate) points: usize,
    /// Leave paths.csv out: it has some hundred rows a spectrum
    #[arg(long)]
    pub(crate) no_paths: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Plugins {
    /// Only this plugin, or all of this kind (such as Pruner)
    #[arg(value_name = "NAME")]
    pub(crate) name: Option<String>,
}

#[cfg(test)]
mod tests {
    use super::{Shard, shard};
    use clap::CommandFactory as _;

    #[test]
    fn a_shard_is_a_part_of_a_whole() {
        assert_eq!(shard("2/5"), Ok(Shard { index: 2, count: 5 }));
        for wrong in ["0/5", "6/5", "2", "a/b", "1/0", "-1/2"] {
            assert!(shard(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_command_line_is_consistent() {
        super::Arguments::command().debug_assert();
    }
}

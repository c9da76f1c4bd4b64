//! Tested readers with their files; if a reader accepts a file, the next steps of the program are also performed, as
//! far as they stay small.

use crate::folder::copy;
use crate::mutate::Form;
use pwrfgs::data::TableImport;
use pwrfgs::data::import::{ChannelImport, Import};
use pwrfgs::data::{Predictions, check_dataset};
use pwrfgs::experiment::sweep::SweepPlan;
use pwrfgs::experiment::{self, Session, read_pipeline};
use pwrfgs::model::export::{npz, ply};
use pwrfgs::model::file;
use pwrfgs::prelude::*;
use pwrfgs::report::{ReportOptions, Study};
use pwrfgs::tasks::predict::{PredictSettings, write_predictions};
use std::fs;
use std::path::Path;

/// File with its reader.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Mutated file, relative to the bench.
    pub file: &'static str,
    /// Seed files or folders; its own file first.
    pub seeds: &'static [&'static str],
    /// Format of the file.
    pub form: Form,
    /// Number of its cases per round.
    pub share: usize,
    /// Reader of the file.
    pub reader: Reader,
}

/// Reader of a file.
#[derive(Clone, Copy, Debug)]
pub enum Reader {
    /// Library function, called with the bench.
    Library(fn(&Path) -> Result<()>),
    /// Program with these arguments, called in the bench.
    Program(&'static [&'static str]),
}

impl Target {
    /// Command that reads it, if it is a program target.
    pub fn command(&self) -> String {
        match self.reader {
            Reader::Program([command, ..]) => format!(" for pwrfgs {command}"),
            _ => String::new(),
        }
    }
}

const fn of(
    share: usize,
    file: &'static str,
    seeds: &'static [&'static str],
    form: Form,
    reader: fn(&Path) -> Result<()>,
) -> Target {
    Target { file, seeds, form, share, reader: Reader::Library(reader) }
}

const fn program(file: &'static str, form: Form, arguments: &'static [&'static str]) -> Target {
    Target { file, seeds: &[], form, share: 1, reader: Reader::Program(arguments) }
}

use Form::{Archive, Jpeg, Plain, Png, Tensors};
const MODEL: &str = "models/model.safetensors";
const UPDATED: &str = "kriged/model.safetensors";
// The random data of the bench are far from its model of one transmitter.
const UPDATE: &[&str] =
    &["update", UPDATED, "--data", "data", "--out", "updated.safetensors", "--accept", "far-from-model", "-q"];
const PREDICT: &[&str] = &["predict", MODEL, "--tx-csv", "positions.csv", "--out", "heard", "-q"];

/// All formats.
pub const TARGETS: &[Target] = &[
    of(48, "p.ron", &["pipelines"], Plain, pipeline),
    of(32, "e.ron", &["experiments"], Plain, experiment),
    of(16, "scene.ron", &[], Plain, |bench| scene(bench, "scene.ron")),
    of(24, "scene.xml", &[], Plain, |bench| scene(bench, "scene.xml")),
    of(32, "data/gateway_info.yml", &[], Plain, |bench| step(bench, "measured.ron")),
    of(32, "data/tx_pos.csv", &[], Plain, |bench| step(bench, "measured.ron")),
    of(16, "data/train_index.txt", &["data/test_index.txt"], Plain, |bench| step(bench, "measured.ron")),
    of(8, "data/manifest.json", &[], Plain, |bench| step(bench, "measured.ron")),
    of(40, "data/spectrum/00002.png", &["data/spectrum"], Png, |bench| step(bench, "measured.ron")),
    of(8, "rssi/gateway_position.yml", &[], Plain, |bench| step(bench, "powers.ron")),
    of(24, "rssi/gateway_rssi.csv", &[], Plain, |bench| step(bench, "powers.ron")),
    of(8, "links.csv", &[], Plain, |bench| table(bench, "links.csv")),
    of(2, "links.csv.gz", &[], Plain, |bench| table(bench, "links.csv.gz")),
    of(8, "poses.csv", &[], Plain, |bench| pwrfgs::data::read_poses(&bench.join("poses.csv")).map(drop)),
    of(8, "colmap/sparse/0/cameras.txt", &[], Plain, cameras),
    of(16, "colmap/sparse/0/images.txt", &[], Plain, cameras),
    of(8, "colmap/images/00002.png", &[], Png, cameras),
    of(8, "colmap/images/00003.jpg", &[], Jpeg, cameras),
    of(24, "arrays.npz", &["deflated.npz"], Archive, imported),
    of(8, "colmap/sparse/0/points3D.txt", &[], Plain, cameras),
    of(8, "freq.txt", &[], Plain, |bench| pwrfgs::data::read_carriers(&bench.join("freq.txt")).map(drop)),
    of(8, "predicted/00004.npy", &[], Plain, |bench| predicted(bench, "measured.ron")),
    of(8, "predicted/predictions.csv", &[], Plain, |bench| predicted(bench, "powers.ron")),
    of(4, "rssi/train_index.txt", &["rssi/test_index.txt"], Plain, |bench| step(bench, "powers.ron")),
    of(4, "rssi/ids.txt", &[], Plain, |bench| step(bench, "powers.ron")),
    of(4, "rssi/manifest.json", &[], Plain, |bench| step(bench, "powers.ron")),
    of(4, "rssi/links.txt", &[], Plain, |bench| {
        load(bench, "Subset(data: Nerf2Rssi(root: \"rssi\"), links: \"rssi/links.txt\")")
    }),
    of(16, "channels/receiver.yml", &[], Plain, channels),
    of(16, "channels/channel.npy", &[], Plain, channels),
    of(16, "pairs.npy", &[], Plain, imported_channels),
    of(8, "csi/base-station.yml", &[], Plain, csi),
    of(8, "csi/csidata.npy", &[], Plain, csi),
    of(32, "cloud/mesh.ply", &["cloud/binary/mesh.ply"], Plain, surface),
    of(24, "cloud/points.xyz", &[], Plain, cloud),
    of(24, "cloud/points.csv", &[], Plain, cloud),
    of(24, "cloud/mesh.obj", &[], Plain, surface),
    of(64, MODEL, &["models"], Tensors, model),
    of(32, "half/checkpoint.safetensors", &[], Tensors, checkpoint),
    of(4, "half/checkpoint.safetensors", &[], Tensors, resumed),
    of(4, "half/run.json", &[], Plain, resumed),
    of(4, "half/curve.csv", &["half/validation.csv"], Plain, resumed),
    of(4, "half/validation.csv", &["half/curve.csv"], Plain, resumed),
    of(4, "half/events.out.tfevents.pwrfgs", &[], Plain, resumed),
    of(4, "half/unpruned.safetensors", &["half/start.safetensors"], Tensors, resumed),
    of(4, "half/pipeline.ron", &[], Plain, resumed),
    of(4, "scored/scoring.partial", &[], Plain, scored),
    of(2, "unfinished.partial/predictions.csv", &[], Plain, completed),
    of(2, "unfinished.partial/.pwrfgs-request", &[], Plain, completed),
    of(4, "sweep/sweep.json", &[], Plain, read_back),
    of(8, "sweep/a/run.json", &[], Plain, read_back),
    of(8, "sweep/a/scores.csv", &[], Plain, read_back),
    of(8, "sweep/a/samples.csv", &[], Plain, read_back),
    of(4, "sweep/a/pipeline.ron", &[], Plain, read_back),
    of(1, "sweep/a/run.json", &[], Plain, compared),
    of(1, "sweep/a/scores.csv", &[], Plain, compared),
    of(1, "sweep/a/samples.csv", &[], Plain, compared),
    of(1, "sweep/a/model.safetensors", &[], Tensors, compared),
    program("positions.csv", Plain, PREDICT),
    program("positions.csv", Plain, PREDICT),
    program(MODEL, Tensors, PREDICT),
    program(MODEL, Tensors, &["export", MODEL, "--npz", "out.npz", "--ply", "out.ply", "-q"]),
    program("observed.csv", Plain, &["locate", "powers/model.safetensors", "observed.csv", "-q"]),
    program("observed.npy", Plain, &["locate", "sweep/a/model.safetensors", "observed.npy", "-q"]),
    program(UPDATED, Tensors, UPDATE),
    program("data/tx_pos.csv", Plain, UPDATE),
    program("p.ron", Plain, &["run", "p.ron", "--out", "ran", "-q"]),
    program("e.ron", Plain, &["sweep", "e.ron", "--dry-run", "-q"]),
    program("sweep/a/run.json", Plain, &["run", "p.ron", "--out", "sweep/a", "-q"]),
    program("sweep/a/scores.csv", Plain, &["report", "sweep", "--out", "compared", "-q"]),
    program("scene.ron", Plain, &["simulate", "scene.ron", "--out", "simulated", "--samples", "5", "-q"]),
];

/// Reads a table of powers.
fn table(bench: &Path, name: &str) -> Result<()> {
    let files = vec![bench.join(name).into_os_string().into()];
    let import = TableImport { files, title: "links".into(), ..TableImport::default() };
    import.read(&|_, _| {}).and_then(|imported| check_dataset(&imported.data))
}

fn pipeline(bench: &Path) -> Result<()> {
    let pipeline = read_pipeline(&bench.join("p.ron"), &[])?;
    if is_small(&pipeline) { first_step(&pipeline, bench) } else { Ok(()) }
}

/// Whether all numbers of the plugins are small, since large ones rightly take long.
fn is_small(pipeline: &Pipeline) -> bool {
    let Pipeline { data, split, initializer, projector, rasterizer, deformation, pruners, .. } = pipeline;
    let text = format!("{data:?} {split:?} {initializer:?} {projector:?} {rasterizer:?} {deformation:?} {pruners:?}");
    let numbers = text.split(|c: char| !c.is_ascii_digit() && !".e-".contains(c));
    let small = numbers.filter_map(|number| number.parse::<f64>().ok()).all(|number| number.abs() <= 64.0);
    small && pipeline.training.batch <= 16 && !text.contains("Simulated") && !text.contains("seed: 1e")
}

/// Loads, initialises, trains one step and predicts.
fn first_step(pipeline: &Pipeline, bench: &Path) -> Result<()> {
    let experiment::SplitData { data, partition } =
        experiment::load_split_data(&experiment::rebased(pipeline, bench)?, &mut NoopObserver)?;
    let mut trainer = pipeline.trainer(&data, &partition)?;
    trainer.step()?;
    trainer.model().prepare().predict_many(&[[0.5, 0.5, 0.5].into()]);
    Ok(())
}

/// First step of a pipeline on the bench.
fn step(bench: &Path, name: &str) -> Result<()> {
    first_step(&read_pipeline(&bench.join(name), &[])?, bench)
}

fn experiment(bench: &Path) -> Result<()> {
    let plan = SweepPlan::read(&bench.join("e.ron"), &[], None)?;
    plan.listing();
    Ok(())
}

fn scene(bench: &Path, name: &str) -> Result<()> {
    let one = pwrfgs::raytrace::Simulated {
        scene: name.into(),
        samples: 5, // fewer are refused before the scene is read
        points: 16,
        cache: false,
        ..Default::default()
    };
    one.load(bench, &|_, _| {}).map(drop)
}

fn channels(bench: &Path) -> Result<()> {
    step(bench, "channels.ron").and_then(|()| load(bench, "Channels(root: \"channels\")"))
}

fn csi(bench: &Path) -> Result<()> {
    load(bench, "Nerf2Csi(root: \"csi\")")?;
    load(bench, "Nerf2Csi(root: \"csi\", together: true)")
}

fn cameras(bench: &Path) -> Result<()> {
    load(bench, "Colmap(root: \"colmap\")")
}

/// Imports the archive of spectra and positions.
fn imported(bench: &Path) -> Result<()> {
    let out = bench.join("imported");
    let _ = fs::remove_dir_all(&out);
    let import = Import {
        spectra: bench.join("arrays.npz"),
        tx: None,
        receiver: Pose::IDENTITY,
        elevation: None,
        name: "imported".into(),
        scale: None,
        colormap: None,
        simulated: false,
    };
    import.write(&out, &|_, _| {})?;
    load(bench, "Arrays(root: \"imported\")")
}

/// Imports pairs of imaginary and real parts as channels, and as powers.
fn imported_channels(bench: &Path) -> Result<()> {
    let import = ChannelImport {
        channels: vec![bench.join("pairs.npy")],
        imag: Vec::new(),
        axes: "ir,f,m".into(),
        tx: Some(bench.join("channels/tx_pos.csv")),
        receiver: Pose::IDENTITY,
        antennas: None,
        carrier_hz: Some(2e9),
        spacing_hz: Some(1e6),
        powers: false,
        name: "imported".into(),
        simulated: false,
    };
    check_dataset(&import.read()?.0)?;
    check_dataset(&ChannelImport { powers: true, ..import }.read()?.0)
}

/// Checks predictions for the test set of a pipeline on the bench.
fn predicted(bench: &Path, name: &str) -> Result<()> {
    let pipeline = read_pipeline(&bench.join(name), &[])?;
    let experiment::SplitData { data, partition } =
        experiment::load_split_data(&experiment::rebased(&pipeline, bench)?, &mut NoopObserver)?;
    Predictions { root: bench.join("predicted"), ..Predictions::default() }.check_test(&data, &partition.test)
}

fn load(bench: &Path, source: &str) -> Result<()> {
    let source = Plugin::<dyn DataSource>::parse(source).map_err(Error::Config)?;
    source.load(bench, &|_, _| {})?.observations.check()
}

/// Reads all point files, one of which is mutated.
fn cloud(bench: &Path) -> Result<()> {
    ["points.xyz", "points.csv", "mesh.ply"].into_iter().try_for_each(|name| {
        let mut pipeline = read_pipeline(&bench.join("points.ron"), &[])?;
        pipeline.set(&format!("data=Nerf2Spectrum(root: \"data\", points: \"cloud/{name}\")"))?;
        first_step(&pipeline, bench)
    })
}

/// Reads all meshes, one of which is mutated; one of them is also a point cloud.
fn surface(bench: &Path) -> Result<()> {
    for name in ["mesh.ply", "mesh.obj"] {
        pwrfgs::data::read_mesh(&bench.join("cloud").join(name))?;
    }
    cloud(bench)
}

fn model(bench: &Path) -> Result<()> {
    let model = file::read_ensemble(&bench.join(MODEL))?;
    model.prepare().predict_many(&[[0.5, 0.5, 0.5].into()]);
    model.calibration().map(|own| own.factors(0.5)).transpose()?;
    npz(&model, None)?;
    ply(&model, Some([0.5, 0.5, 0.5])).map(drop)
}

fn checkpoint(bench: &Path) -> Result<()> {
    let pipeline = read_pipeline(&bench.join("p.ron"), &[])?;
    let experiment::SplitData { data, partition } =
        experiment::load_split_data(&experiment::rebased(&pipeline, bench)?, &mut NoopObserver)?;
    let path = bench.join("half/checkpoint.safetensors");
    let bytes = fs::read(&path).map_err(|e| Error::read(&path, e))?;
    let mut trainer = Trainer::restore(&pipeline.plan()?, &data, &partition, &bytes)?;
    if !trainer.finished() {
        trainer.step()?;
    }
    trainer.checkpoint();
    Ok(())
}

/// Resumes a copy of the interrupted run up to its scores; the report has separate cases.
fn resumed(bench: &Path) -> Result<()> {
    resume(bench, "half")
}

/// Resumes a copy of the run whose scoring was interrupted.
fn scored(bench: &Path) -> Result<()> {
    resume(bench, "scored")
}

/// Resumes a copy of the run in a folder of the bench.
fn resume(bench: &Path, run: &str) -> Result<()> {
    let again = bench.join("again");
    let _ = fs::remove_dir_all(&again);
    copy(&bench.join(run), &again)?;
    let pipeline = read_pipeline(&bench.join("p.ron"), &[])?;
    experiment::run(&pipeline, bench, &again, &mut Session::new(&mut NoopObserver)).map(drop)
}

/// Completes a copy of the interrupted predictions.
fn completed(bench: &Path) -> Result<()> {
    for path in ["completed", "completed.partial"] {
        let _ = fs::remove_dir_all(bench.join(path));
    }
    copy(&bench.join("unfinished.partial"), &bench.join("completed.partial"))?;
    predict(bench, "completed", Session::new(&mut NoopObserver))
}

/// Predicts more spectra than one block of rows has, into a folder of the bench.
pub(crate) fn predict(bench: &Path, out: &str, mut session: Session<'_>) -> Result<()> {
    let poses: Vec<Pose> = (0..2_100).map(|k| [0.5, 0.5, f64::from(k) / 2_100.0].into()).collect();
    let settings = PredictSettings { stacked: true, no_png: true, ..PredictSettings::default() };
    write_predictions(&file::read_ensemble(&bench.join(MODEL))?, &poses, &settings, &bench.join(out), &mut session)
        .map(drop)
}

fn read_back(bench: &Path) -> Result<()> {
    Study::read(&[bench.join("sweep")]).map(drop)
}

/// Compares the finished run, with every figure.
fn compared(bench: &Path) -> Result<()> {
    let study = Study::read(&[bench.join("sweep")])?;
    pwrfgs::report::write(&study, &ReportOptions::default(), &bench.join("compared"), &mut NoopObserver).map(drop)
}

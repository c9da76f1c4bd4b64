//! Mutation tests of all file readers of pwrfgs.
//!
//! A case is a number that determines the file and its mutation, so that a failed case can be repeated. (`run.json`,
//! `curve.csv` and the event file contain times, so these digits differ between runs.) A case passes if the reader
//! accepts the file or reports an input error: no panic, no abort, no hang, no error that blames the machine, no
//! endless message.

#![allow(clippy::disallowed_methods)] // it reads its own files

mod folder;
pub mod mutate;
pub mod targets;

use folder::{copy, files};
use mutate::mutate;
use pwrfgs::data::npy_header;
use pwrfgs::experiment::sweep::{ListedRun, Listing};
use pwrfgs::experiment::{Session, SplitData, read_pipeline};
use pwrfgs::model::{compress, file};
use pwrfgs::prelude::*;
use pwrfgs_core::{Number, rng};
use std::fs;
use std::io::{Cursor, Write as _};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use targets::{Reader, TARGETS, Target};
use zip::{CompressionMethod, ZipWriter, result::ZipError, write::SimpleFileOptions};

/// Environment variable that makes the fuzzer act as `pwrfgs`.
pub const AS_PROGRAM: &str = "PWRFGS_FUZZ_AS_PROGRAM";
/// Outputs of program calls, removed before each call: existing ones would be an error.
const WRITTEN: [&str; 7] = ["ran", "simulated", "compared", "heard", "out.npz", "out.ply", "updated.safetensors"];
/// Longest processor time of a case, seconds.
const PATIENCE: f64 = 10.0;
/// Longest message, bytes.
const LONGEST_MESSAGE: usize = 2_000;
/// Last bytes of a file, without which it is cut short. A PNG file has all its pixels before them.
const END: usize = 16;
/// Models other than that of the pipeline.
const MODELS: [&[&str]; 5] = [
    &["deformation=Fixed()", "readout=Real", "calibration=AsReleased", "projector=WrfgsCompat()"],
    &["deformation=Factored(depth: 2, width: 8, position_encoding: Waves(count: 3, reach: 4.0, seed: 0))"],
    &["deformation=Wrfgs(depth: 2, width: 8, frequencies: 2, skip: None)", "readout=Power"],
    &["rasterizer=ArrayResponse(rows: 2, columns: 2)", "readout=Magnitude"],
    &["readout=MinMax", "initializer=Random(count: 5, std: 1.0)"],
];

/// Test folder with one small file of every format, and their original contents.
#[derive(Debug)]
pub struct Bench {
    folder: PathBuf,
    /// Seed files of each target, its own file first.
    seeds: Vec<Vec<Vec<u8>>>,
}

impl Bench {
    /// Creates the folder from `fuzz/seeds`, shipped files, and files written by the library.
    ///
    /// # Errors
    /// A file that cannot be read or written.
    pub fn new(folder: &Path) -> Result<Self> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        copy(&root.join("seeds"), folder)?;
        for name in ["pipelines", "experiments", "scenes"] {
            copy(&root.join("..").join(name), &folder.join(name))?;
        }
        for name in ["data/spectrum", "colmap/images"] {
            fs::create_dir_all(folder.join(name)).map_err(|e| Error::write(folder, e))?;
        }
        for id in 1..=5 {
            let picture = image::GrayImage::from_fn(12, 6, |x, y| image::Luma([(7 * x + 11 * y * id) as u8]));
            for path in ["data/spectrum", "colmap/images"].map(|at| folder.join(format!("{at}/{id:05}.png"))) {
                picture.save(&path).map_err(|e| Error::input(&path, e))?;
            }
        }
        let path = folder.join("colmap/images/00003.jpg");
        image::GrayImage::from_fn(12, 6, |x, y| image::Luma([(17 * x * y) as u8]))
            .save(&path)
            .map_err(|e| Error::input(&path, e))?;
        archives(folder)?;
        runs(folder)?;
        models(folder)?;
        unfinished_predictions(folder)?;
        let seeds = TARGETS.iter().map(|target| seeds(folder, target)).collect::<Result<_>>()?;
        Ok(Self { folder: folder.into(), seeds })
    }

    /// Returns the contents of the seed files of target number `target`.
    pub fn seeds(&self, target: usize) -> &[Vec<u8>] {
        &self.seeds[target]
    }

    /// Runs case `n` and restores the bench, or keeps the broken file if `keep`. Returns the fault, if any.
    ///
    /// # Errors
    /// The bench cannot be written.
    pub fn try_case(&self, n: u64, keep: bool) -> Result<Option<String>> {
        let target = target_of(n);
        let seeds = &self.seeds[target];
        let mut random = rng::stream(0, "fuzz", n);
        let (seed, other) = (rng::below(&mut random, seeds.len()), rng::below(&mut random, seeds.len()));
        self.try_bytes(target, &mutate(&seeds[seed], &seeds[other], TARGETS[target].form, &mut random), keep)
    }

    /// Tests `bytes` as the file of target number `target`, like [`Self::try_case`].
    ///
    /// # Errors
    /// The bench cannot be written.
    pub fn try_bytes(&self, target: usize, bytes: &[u8], keep: bool) -> Result<Option<String>> {
        let path = self.folder.join(TARGETS[target].file);
        let put = |bytes: &[u8]| fs::write(&path, bytes).map_err(|e| Error::write(&path, e));
        put(bytes)?;
        let begun = processor_seconds();
        let refusal = self.refusal(target)?;
        if !keep {
            put(&self.seeds[target][0])?;
        }
        let slow = (processor_seconds() - begun > PATIENCE).then(|| "takes too long".into());
        let is_start = |seed: &Vec<u8>| bytes.len() + END <= seed.len() && seed.starts_with(bytes);
        let is_cut = TARGETS[target].form.has_end() && self.seeds[target].iter().any(is_start);
        let cut = (is_cut && refusal.is_none()).then(|| "accepts a file that is cut short".into());
        Ok(refusal.and_then(|refusal| refusal.fault()).or(slow).or(cut))
    }

    /// Error of the reader of target number `target` for its valid file, if any. If the reader rejects the valid file,
    /// its cases test nothing.
    ///
    /// # Errors
    /// The program cannot be called.
    pub fn refusal(&self, target: usize) -> Result<Option<Refusal>> {
        let arguments = match TARGETS[target].reader {
            Reader::Library(read) => {
                return Ok(read(&self.folder).err().map(|e| Refusal { is_input: e.is_input(), text: e.to_string() }));
            }
            Reader::Program(arguments) => arguments,
        };
        let failed = |e| Error::Config(format!("the program cannot be called: {e}"));
        let mut command = Command::new(std::env::current_exe().map_err(failed)?);
        command.args(arguments).current_dir(&self.folder).env(AS_PROGRAM, "1").env_remove("RUST_LOG");
        let output = command.output().map_err(failed)?;
        for path in WRITTEN.map(|name| self.folder.join(name)) {
            let _ = fs::remove_dir_all(&path).or_else(|_| fs::remove_file(&path));
        }
        let text = String::from_utf8_lossy(&output.stderr).trim_end().replace('\n', "; ");
        let is_input = matches!(output.status.code(), Some(0..=2));
        let text = if is_input { text } else { format!("{}: {text}", output.status) };
        Ok((!output.status.success()).then_some(Refusal { is_input, text }))
    }
}

/// Error of a reader.
#[derive(Debug)]
pub struct Refusal {
    is_input: bool,
    /// Error message.
    pub text: String,
}

impl Refusal {
    /// Returns the problem with the message; `None` if it is acceptable.
    fn fault(&self) -> Option<String> {
        let start: String = self.text.chars().take(200).collect();
        match () {
            () if !self.is_input => Some(format!("blames the machine: {start:?}")),
            () if self.text.len() > LONGEST_MESSAGE => Some(format!("says {} bytes: {start:?}", self.text.len())),
            // Findings have a line each.
            () if self.text.contains(|c: char| c.is_control() && c != '\n') => {
                Some(format!("says a control character: {start:?}"))
            }
            () => None,
        }
    }
}

/// Processor time of this process, seconds; 0 if unavailable.
fn processor_seconds() -> f64 {
    let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields);
    // User and system time in hundredths.
    fields.split_whitespace().skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// Target of a case: targets alternate in proportion to their share.
pub fn target_of(n: u64) -> usize {
    let places = || TARGETS.iter().enumerate().flat_map(|(place, target)| std::iter::repeat_n(place, target.share));
    // The step has no common divisor with most rounds, so that any range of cases covers all targets.
    places().nth((n.wrapping_mul(7_919) % places().count() as u64) as usize).unwrap_or_default()
}

/// Contents of a target's file and of its seed files.
fn seeds(folder: &Path, target: &Target) -> Result<Vec<Vec<u8>>> {
    let all = std::iter::once(&target.file).chain(target.seeds).map(|name| files(&folder.join(name)));
    let read = |path: &PathBuf| fs::read(path).map_err(|e| Error::read(path, e));
    all.collect::<Result<Vec<_>>>()?.concat().iter().map(read).collect()
}

/// Creates archives of four spectra and their positions, with and without compression.
fn archives(folder: &Path) -> Result<()> {
    let spectra: Vec<u8> = (0..4 * 6 * 24).map(|v| (v % 251) as u8).collect();
    let positions: Vec<u8> = (0..12).flat_map(|v| f64::from(v).to_le_bytes()).collect();
    for (name, method) in [("arrays.npz", CompressionMethod::Stored), ("deflated.npz", CompressionMethod::Deflated)] {
        let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
        let mut put = |name: &str, header: Vec<u8>, numbers: &[u8]| {
            archive.start_file(name, SimpleFileOptions::default().compression_method(method))?;
            archive.write_all(&[&header, numbers].concat())?;
            Ok(())
        };
        let done = put("spectra.npy", npy_header(Number::U8, &[4, 6, 24]), &spectra)
            .and_then(|()| put("tx.npy", npy_header(Number::F64, &[4, 3]), &positions))
            .and_then(|()| Ok(fs::write(folder.join(name), archive.finish()?.into_inner())?));
        done.map_err(|e: ZipError| Error::input(&folder.join(name), e))?;
    }
    Ok(())
}

/// Creates a sweep folder with one finished run, runs of powers and with Kriged residuals, and an interrupted run.
fn runs(folder: &Path) -> Result<()> {
    let whole = |pipeline: &Pipeline, out| {
        pwrfgs::run(pipeline, folder, &folder.join(out), &mut NoopObserver, &AtomicBool::new(false))
    };
    let pipeline = read_pipeline(&folder.join("p.ron"), &[])?;
    whole(&pipeline, "sweep/a")?;
    whole(&read_pipeline(&folder.join("powers.ron"), &[])?, "powers")?;
    let kriged = ["residuals=Kriged()", "training.batch=1"].map(String::from); // one transmitter remains for training
    whole(&read_pipeline(&folder.join("measured.ron"), &kriged)?, "kriged")?;
    let run = ListedRun { folder: "a".into(), labels: vec![("steps".into(), "4".into())], seed: 1 };
    Listing { name: "sweep".into(), runs: vec![run] }.write(&folder.join("sweep"))?;
    let stop = AtomicBool::new(false);
    pwrfgs::run(&pipeline, folder, &folder.join("half"), &mut Stopper(&stop), &stop)?;
    let stop = AtomicBool::new(false);
    pwrfgs::run(&pipeline, folder, &folder.join("scored"), &mut StageStopper(&stop, "predicting with mean"), &stop)?;
    Ok(())
}

/// Stops a run after its third step, after pruning and a validation.
struct Stopper<'a>(&'a AtomicBool);

impl Observer for Stopper<'_> {
    fn on_step(&mut self, report: &StepReport) {
        self.0.store(report.step >= 3, Ordering::Relaxed);
    }
}

/// Stops the work when a stage begins whose name starts with these words.
struct StageStopper<'a>(&'a AtomicBool, &'static str);

impl Observer for StageStopper<'_> {
    fn on_stage(&mut self, name: &str, _: usize, _: usize) {
        self.0.fetch_or(name.starts_with(self.1), Ordering::Relaxed);
    }
}

/// Creates predictions that were stopped after the first rows.
fn unfinished_predictions(folder: &Path) -> Result<()> {
    let stop = AtomicBool::new(false);
    let mut observer = StageStopper(&stop, "predicting");
    let session = Session { stop: &stop, ..Session::new(&mut observer) };
    match targets::predict(folder, "unfinished", session) {
        Err(Error::Stopped) => Ok(()),
        other => other,
    }
}

/// Creates untrained models of every kind, and the trained one in other formats.
fn models(folder: &Path) -> Result<()> {
    let path = |name: &str| folder.join("models").join(name);
    fs::create_dir_all(folder.join("models")).map_err(|e| Error::write(folder, e))?;
    for (i, settings) in MODELS.iter().enumerate() {
        let mut pipeline = read_pipeline(&folder.join("p.ron"), &[])?;
        settings.iter().try_for_each(|setting| pipeline.set(setting))?;
        let SplitData { data, partition } =
            pwrfgs::experiment::load_split_data(&pwrfgs::experiment::rebased(&pipeline, folder)?, &mut NoopObserver)?;
        file::write(&path(&format!("{i}.safetensors")), &pipeline.trainer(&data, &partition)?.model())?;
    }
    let trained = file::read_ensemble(&folder.join("sweep/a/model.safetensors"))?;
    let half = path("half.safetensors");
    fs::write(&half, file::to_bytes_half(&trained)?).map_err(|e| Error::write(&half, e))?;
    let small = path("compressed.safetensors");
    let bytes = compress::to_bytes(&trained, compress::Bits::Eight)?;
    fs::write(&small, bytes).map_err(|e| Error::write(&small, e))?;
    let pair = Ensemble::new([trained.members(), trained.members()].concat()).map_err(Error::Config)?;
    file::write_ensemble(&path("pair.safetensors"), &pair)?;
    file::write_ensemble(&path("model.safetensors"), &trained)
}

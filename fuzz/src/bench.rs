//! The folder that cases are tried in: one small file of every format, from `fuzz/seeds` or made by the library itself.

use pwrfgs::experiment::sweep::{ListedRun, Listing};
use pwrfgs::experiment::{load, read_pipeline};
use pwrfgs::model::file;
use pwrfgs::prelude::*;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// Other models than that of the pipeline.
const MODELS: [&[&str]; 5] = [
    &["deformation=Fixed()", "readout=Real", "calibration=AsReleased", "projector=WrfgsCompat()"],
    &["deformation=Factored(depth: 2, width: 8, position_encoding: Waves(count: 3, reach: 4.0, seed: 0))"],
    &["deformation=Wrfgs(depth: 2, width: 8, frequencies: 2, skip: None)", "readout=Power"],
    &["rasterizer=ArrayResponse(rows: 2, columns: 2)", "readout=Magnitude"],
    &["readout=MinMax", "initializer=Random(count: 5, std: 1.0)"],
];

/// Makes the folder.
pub fn make(folder: &Path) -> Result<()> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    copy(&root.join("seeds"), folder)?;
    // What a user begins with.
    for name in ["pipelines", "experiments", "scenes"] {
        copy(&root.join("..").join(name), &folder.join(name))?;
    }
    fs::create_dir_all(folder.join("data/spectrum")).map_err(|e| Error::write(folder, e))?;
    for id in 1..=5 {
        let path = folder.join(format!("data/spectrum/{id:05}.png"));
        let picture = image::GrayImage::from_fn(12, 6, |x, y| image::Luma([(7 * x + 11 * y * id) as u8]));
        picture.save(&path).map_err(|e| Error::input(&path, e))?;
    }
    runs(folder)?;
    models(folder)
}

/// Copies all files below a folder.
fn copy(from: &Path, to: &Path) -> Result<()> {
    fs::create_dir_all(to).map_err(|e| Error::write(to, e))?;
    for entry in fs::read_dir(from).map_err(|e| Error::read(from, e))?.flatten() {
        let (path, copied) = (entry.path(), to.join(entry.file_name()));
        if path.is_dir() {
            copy(&path, &copied)?;
        } else {
            // Not `fs::copy`, which takes permissions along: a checkout may be read-only.
            fs::read(&path).and_then(|bytes| fs::write(&copied, bytes)).map_err(|e| Error::write(&copied, e))?;
        }
    }
    Ok(())
}

/// A sweep folder with one finished run, and a run that was stopped half-way.
fn runs(folder: &Path) -> Result<()> {
    let pipeline = read_pipeline(&folder.join("p.ron"), &[])?;
    pwrfgs::run(&pipeline, folder, &folder.join("sweep/a"), &mut Silent, &AtomicBool::new(false))?;
    let run = ListedRun { folder: "a".into(), labels: vec![("steps".into(), "4".into())], seed: 1 };
    Listing { name: "sweep".into(), runs: vec![run] }.write(&folder.join("sweep"))?;
    let stop = AtomicBool::new(false);
    pwrfgs::run(&pipeline, folder, &folder.join("half"), &mut Stopper(&stop), &stop)?;
    Ok(())
}

/// Stops a run after its third step: pruned, and a look at the validation part behind it.
struct Stopper<'a>(&'a AtomicBool);

impl Observer for Stopper<'_> {
    fn on_step(&mut self, report: &StepReport) {
        self.0.store(report.step >= 3, Ordering::Relaxed);
    }
}

/// Untrained models of every kind.
fn models(folder: &Path) -> Result<()> {
    let put = |name: &str, model: &Model| file::write(&folder.join("models").join(name), model);
    fs::create_dir_all(folder.join("models")).map_err(|e| Error::write(folder, e))?;
    for (i, settings) in MODELS.iter().enumerate() {
        let mut pipeline = read_pipeline(&folder.join("p.ron"), &[])?;
        settings.iter().try_for_each(|setting| pipeline.set(setting))?;
        let (data, partition) = load(&pipeline, folder, &mut Silent)?;
        put(&format!("{i}.safetensors"), &pipeline.trainer(&data, &partition)?.model())?;
    }
    let trained = file::read_ensemble(&folder.join("sweep/a/model.safetensors"))?;
    let half = folder.join("models/half.safetensors");
    fs::write(&half, file::to_bytes_half(&trained)?).map_err(|e| Error::write(&half, e))?;
    let pair = Ensemble::new([trained.members(), trained.members()].concat()).map_err(Error::Config)?;
    file::write_ensemble(&folder.join("models/pair.safetensors"), &pair)?;
    file::write_ensemble(&folder.join("models/model.safetensors"), &trained)
}

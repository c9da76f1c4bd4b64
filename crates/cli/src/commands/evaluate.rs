//! `pwrfgs evaluate`: scores of a trained model on data of one's choice.

use crate::args::{Evaluate, Verbosity};
use crate::output;
use crate::progress::Progress;
use pwrfgs::experiment::folder::{PIPELINE, REPORT};
use pwrfgs::experiment::{Facts, Machine, Subject, evaluate as score, load as load_data, read_pipeline};
use pwrfgs::model::{Ensemble, Model, file};
use pwrfgs_core::{Error, Result};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

pub(crate) fn evaluate(arguments: &Evaluate, verbosity: Verbosity) -> Result<ExitCode> {
    let ensemble = read_models(&arguments.models)?;
    let first = &arguments.models[0];
    let beside = first.parent().unwrap_or(Path::new("")).join(PIPELINE);
    let path = arguments.pipeline.as_ref().unwrap_or(&beside);
    if arguments.pipeline.is_none() && !path.is_file() {
        return Err(Error::input(
            first,
            format!("there is no {PIPELINE} beside this model; name one with --pipeline FILE"),
        ));
    }
    let pipeline = read_pipeline(path, &arguments.set)?;
    if let Some(out) = &arguments.out {
        if arguments.models.len() > 1 {
            return Err(Error::Config("--out writes the report of one model; leave it out, or give one model".into()));
        }
        check_empty(out)?;
    }
    let model = &ensemble.members()[0];
    let mut progress = Progress::new(verbosity);
    let (data, partition) = load_data(&pipeline, Path::new(""), &mut progress)?;
    if verbosity != Verbosity::Quiet {
        output::note(&format!("{}: scoring {} test spectra", data.title, partition.test.len()));
        if data.scene.receiver != model.stages.pose {
            output::note("warning: these data have another receiver pose than the model was trained with");
        }
    }
    let assessment = score(&ensemble.prepare(), &pipeline, &data, &partition, &mut progress, &AtomicBool::new(false));
    progress.finish();
    let assessment = assessment?;
    let mut text = assessment.scores.table().to_text();
    if arguments.models.len() > 1 {
        _ = writeln!(text, "\nmodel: {} models, the mean of their pictures", arguments.models.len());
    }
    if let Some(out) = &arguments.out {
        std::fs::create_dir_all(out).map_err(|e| Error::write(out, e))?;
        let facts = Facts {
            version: env!("CARGO_PKG_VERSION").into(),
            machine: Machine::here(),
            gaussians: model.cloud.len(),
            ..Facts::default()
        };
        let subject = Subject {
            pipeline: &pipeline,
            model,
            data: &data,
            partition: &partition,
            assessment: &assessment,
            facts: &facts,
        };
        subject.write(out, None)?;
        _ = writeln!(text, "\nreport: {}", out.join(REPORT).display());
    }
    output::result(&text);
    Ok(ExitCode::SUCCESS)
}

/// All models as one.
pub(super) fn read_models(paths: &[PathBuf]) -> Result<Ensemble> {
    let members: Result<Vec<Model>> = paths.iter().map(|path| file::read(path)).collect();
    Ensemble::new(members?).map_err(Error::Config)
}

/// Refuses a folder that holds something.
fn check_empty(out: &Path) -> Result<()> {
    if out.exists() && !out.is_dir() {
        return Err(Error::Config(format!("{} is no folder; choose another --out", out.display())));
    }
    match std::fs::read_dir(out).ok().and_then(|mut entries| entries.next()) {
        None => Ok(()),
        Some(_) => Err(Error::Config(format!("{} is not empty; choose another --out", out.display()))),
    }
}

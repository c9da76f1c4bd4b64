//! `pwrfgs init`: writes a commented pipeline for the data in a folder.

use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use crate::reference::commented::{CommentStyle, Value};
use crate::reference::example;
use clap::Args;
use pwrfgs::experiment::text::wrapped;
use pwrfgs::prelude::Pipeline;
use pwrfgs::tasks::init::{DataSurvey, name_of, suggest_pipeline};
use pwrfgs_core::docs::Docs;
use pwrfgs_core::files::{check_path, write_new};
use pwrfgs_core::{Error, Result};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Reads spectra, received powers, channels or camera images in the layouts of docs/data.md, with index
files and a point cloud if present. The pipeline runs as written; comments explain the settings.
Without index files, it uses a split that holds out cells of space, so that no test transmitter is
close to a training transmitter. Existing files are never overwritten.

EXAMPLES
  pwrfgs init data/s23
  pwrfgs init data/s23 --out pipelines/mine.ron")]
pub(crate) struct Init {
    /// Folder with the data
    #[arg(value_name = "FOLDER", default_value = ".")]
    pub(crate) folder: PathBuf,
    /// Pipeline file [default: ./NAME.ron, from the name of the folder]
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
}

/// Fields of a pipeline in the file; others are shown if they differ from their default.
const SHOWN: [&str; 9] =
    ["name", "seed", "data", "split", "initializer", "deformation", "readout", "pruners", "training"];

/// Fields among them that only splatting reads.
const OF_SPLATS: [&str; 2] = ["deformation", "readout"];

/// Runs `pwrfgs init`.
pub(crate) fn init(arguments: &Init, verbosity: Verbosity) -> Result<()> {
    let out = arguments.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}.ron", name_of(&arguments.folder))));
    let exists = || Error::input(&out, "file exists and is not overwritten; set another file with --out");
    if out.symlink_metadata().is_ok() {
        return Err(exists());
    }
    check_path(&out)?;
    // Paths in a pipeline are relative to its file.
    let folder = &arguments.folder;
    let beside = out.parent().is_none_or(|parent| parent.as_os_str().is_empty());
    let root = if beside { folder.clone() } else { std::path::absolute(folder).unwrap_or_else(|_| folder.clone()) };
    let survey = RunProgress::during(verbosity, |progress| DataSurvey::of(&root, progress))?;
    let pipeline = suggest_pipeline(&survey, &name_of(folder), &out)?;
    let text = pipeline_text(&survey, &pipeline)?;
    if let Some(parent) = out.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        std::fs::create_dir_all(parent).map_err(|e| Error::write(parent, e))?;
    }
    if !write_new(&out, text.as_bytes())? {
        return Err(exists());
    }
    output::result(&format!("{}: {}\nnext: pwrfgs run {}\n", out.display(), survey.sentence(), out.display()))
}

/// Writes the text of the pipeline file, with comments.
fn pipeline_text(survey: &DataSurvey, pipeline: &Pipeline) -> Result<String> {
    let default = example().map_err(Error::Config)?;
    let value = Value::new(pipeline.to_ron()?).map_err(Error::Config)?;
    let differs = |path: &[&str]| value.at(path) != default.at(path);
    let draws = !differs(&["method"]);
    let shows = |owner: &str, field: &str| match owner {
        "Pipeline" => differs(&[field]) || SHOWN.contains(&field) && (draws || !OF_SPLATS.contains(&field)),
        "Training" => !["loss", "optimizer", "densify"].contains(&field) || differs(&["training", field]),
        "Loss" | "Optimizer" | "Densify" => differs(&["training", &owner.to_lowercase(), field]),
        _ => true,
    };
    let style = CommentStyle { opens: &|field| field != "receiver", shows: &shows };
    let body = style.write(&value, Some(Docs::of::<Pipeline>()), "");
    let mut text = String::new();
    for line in survey.notes() {
        text += &wrapped(&line, ["// "; 2], 100);
    }
    text += "//\n// Brackets show the type of a setting. Settings that are not listed have their defaults: `pwrfgs plugins` lists \
             them,\n// and `pwrfgs plugins NAME` describes them.\n";
    text += &body;
    text.push('\n');
    // The text must parse to the same pipeline.
    let again = Pipeline::parse(&text, Path::new("the new pipeline"))?;
    if again.to_ron()? != pipeline.to_ron()? {
        return Err(Error::Config(
            "the new pipeline does not parse to the intended settings; please report this bug".into(),
        ));
    }
    Ok(text)
}

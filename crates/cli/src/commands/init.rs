//! `pwrfgs init`: writes a commented pipeline for the data in a folder.

use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use crate::reference::commented::{CommentStyle, Value};
use crate::reference::example_pipeline;
use clap::Args;
use pwrfgs::data::Colormap;
use pwrfgs::experiment::run_stage;
use pwrfgs::experiment::text::wrap_words;
use pwrfgs::prelude::Pipeline;
use pwrfgs::tasks::init::{DataSurvey, Effort, pipeline_name};
use pwrfgs_core::docs::Docs;
use pwrfgs_core::files::{check_path, write_new};
use pwrfgs_core::{DataSource, Error, Plugin, Result};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
The command reads spectra, received powers, channels or camera images in the layouts of
docs/data.md. The pipeline can be run without changes; its comments explain the settings. If the
folder has index files, such as train_index.txt and test_index.txt, the pipeline uses their split.
Otherwise, the test set is whole cells of space or, if the positions do not allow cells, a block of
time or random samples. Existing files are never overwritten.

EXAMPLES
  pwrfgs init data/s23
  pwrfgs init data/s23 --out pipelines/mine.ron")]
pub(crate) struct Init {
    /// Folder with the data
    #[arg(value_name = "FOLDER", default_value = ".")]
    pub(crate) folder: PathBuf,
    /// Pipeline file [default: ./NAME.ron, from the name of the folder]
    #[arg(short, long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// Training effort: fast (one model), normal (up to 8 models) or best (up to 16 models)
    #[arg(long, value_name = "EFFORT", default_value = "normal", value_parser = Effort::parse)]
    pub(crate) effort: Effort,
    /// Colour map of camera images, inverted to values: jet, turbo or viridis
    #[arg(long, value_name = "NAME", value_enum, ignore_case = true, hide_possible_values = true)]
    pub(crate) colormap: Option<Colormap>,
    /// Continue despite this finding (a fault in the data that an error names), such as lone-value; repeatable
    #[arg(long, value_name = "FINDING")]
    pub(crate) accept: Vec<String>,
}

/// Fields of a pipeline in the file; others are shown if they differ from their default.
const SHOWN: [&str; 10] =
    ["name", "seed", "members", "data", "split", "initializer", "deformation", "readout", "pruners", "training"];

/// Settings that matter most, which come first; [`format_pipeline`] also names them in the head of the file.
const FIRST: [[&str; 2]; 6] = [
    ["Pipeline", "data"],
    ["Pipeline", "split"],
    ["Pipeline", "pruners"],
    ["Pipeline", "members"],
    ["Pipeline", "training"],
    ["Training", "steps"],
];
/// Line after these settings.
const REST: &str = "Other settings. Their values fit most data.";

/// Fields of [`SHOWN`] that only splatting reads.
const SPLATTING_FIELDS: [&str; 2] = ["deformation", "readout"];

/// Runs `pwrfgs init`: writes the pipeline file, which must not exist yet.
pub(crate) fn init(arguments: &Init, verbosity: Verbosity) -> Result<()> {
    let out =
        arguments.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}.ron", pipeline_name(&arguments.folder))));
    let exists = || Error::input(&out, "file exists and is not overwritten; set another file with --out");
    if out.symlink_metadata().is_ok() {
        return Err(exists());
    }
    check_path(&out)?;
    let folder = &arguments.folder;
    let survey = read_survey(arguments, &out, verbosity)?;
    let (pipeline, sizing) = survey.suggest_pipeline(&pipeline_name(folder), arguments.effort, &out)?;
    let text = format_pipeline(&[survey.notes(), sizing.clone()].concat(), &pipeline)?;
    if let Some(parent) = out.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        std::fs::create_dir_all(parent).map_err(|e| Error::write(parent, e))?;
    }
    if !write_new(&out, text.as_bytes())? {
        return Err(exists());
    }
    output::print_result(&format!(
        "{}: {}\n{}\nnext: pwrfgs run {}\n",
        out.display(),
        survey.describe(),
        sizing[0],
        out.display()
    ))
}

/// Reads the data for the pipeline file `out`; with `--colormap`, as images of a camera.
fn read_survey(arguments: &Init, out: &Path, verbosity: Verbosity) -> Result<DataSurvey> {
    // Paths in a pipeline are relative to its file.
    let folder = &arguments.folder;
    let is_beside = out.parent().is_none_or(|parent| parent.as_os_str().is_empty());
    let absolute = (!is_beside).then(|| std::path::absolute(folder).ok()).flatten();
    let root = absolute.unwrap_or_else(|| folder.clone());
    RunProgress::observe(verbosity, |progress| match arguments.colormap {
        None => DataSurvey::read(&root, &arguments.accept, progress),
        Some(map) => {
            let source = format!("Colmap(root: {:?}, colormap: {map:?})", root.to_string_lossy());
            let source = Plugin::<dyn DataSource>::parse(&source).map_err(Error::Config)?;
            let data = run_stage(progress, "observations", |progress| source.load(Path::new(""), progress))?;
            DataSurvey::of_data(source, data, Some(&root), &arguments.accept, progress)
        }
    })
}

/// Formats the pipeline file, with notes on the data and its size, and comments on the settings. Returns an error if the text
/// does not parse to the same pipeline.
fn format_pipeline(notes: &[String], pipeline: &Pipeline) -> Result<String> {
    let default = example_pipeline().map_err(Error::Config)?;
    let value = Value::new(pipeline.to_ron()?).map_err(Error::Config)?;
    let differs = |path: &[&str]| value.text_at(path) != default.text_at(path);
    let is_splatting = !differs(&["method"]);
    let shows = |owner: &str, field: &str| match owner {
        "Pipeline" => {
            differs(&[field]) || SHOWN.contains(&field) && (is_splatting || !SPLATTING_FIELDS.contains(&field))
        }
        "Training" => !["loss", "optimizer", "densify"].contains(&field) || differs(&["training", field]),
        "Loss" | "Optimizer" | "Densify" => differs(&["training", &owner.to_lowercase(), field]),
        _ => true,
    };
    let style = CommentStyle { opens: &|field| field != "receiver", shows: &shows, first: (&FIRST, REST) };
    let body = style.write(&value, Some(Docs::of::<Pipeline>()), "");
    let mut text = String::new();
    for line in notes {
        text += &wrap_words(line, ["// "; 2], 100);
    }
    text += "//\n// The five settings above the line matter most: `data`, `split`, `pruners` (how many Gaussians remain), \
             `members` (number\n// of models) and `training.steps`.\n// Brackets show the type of a setting. Settings that are \
             not listed have their defaults: `pwrfgs plugins` lists them,\n// and `pwrfgs plugins NAME` describes them.\n";
    text += &body;
    text.push('\n');
    let parsed = Pipeline::parse(&text, Path::new("the new pipeline"))?;
    if parsed.to_ron()? != pipeline.to_ron()? {
        return Err(Error::Config(
            "the new pipeline does not parse to the intended settings; please report this bug".into(),
        ));
    }
    Ok(text)
}

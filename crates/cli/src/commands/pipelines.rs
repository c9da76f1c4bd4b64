//! `pwrfgs pipelines`: lists the shipped pipelines, experiments and models, or writes a pipeline to a file.

use crate::output;
use clap::Args;
use pwrfgs::experiment::text::align_columns;
use pwrfgs_core::files::{check_file_path, write_new};
use pwrfgs_core::{Error, Result, ShippedFile, ShippedModel, did_you_mean};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Commands that read a pipeline or a model also accept its name in this list; `pwrfgs sweep` accepts
the name of an experiment. Relative paths in a listed file, such as data/s23, start in the current
directory. A file in the current directory with the given name has priority over this list. For
models, a folder with the given name has priority, too.

EXAMPLES
  pwrfgs pipelines
  pwrfgs run quickstart
  pwrfgs view s23
  pwrfgs sweep paper-office --dry-run
  pwrfgs pipelines --copy s23-laptop")]
pub(crate) struct Pipelines {
    /// Write this pipeline or experiment to NAME.ron in the current directory
    #[arg(long, value_name = "NAME")]
    pub(crate) copy: Option<String>,
}

/// Runs `pwrfgs pipelines`: prints the names of the shipped files, or copies one into the current directory.
pub(crate) fn list_or_copy_pipelines(arguments: &Pipelines) -> Result<()> {
    let [pipelines, experiments, scenes] =
        [ShippedFile::PIPELINES, ShippedFile::EXPERIMENTS, ShippedFile::SCENES].map(ShippedFile::all);
    if let Some(name) = &arguments.copy {
        let files = || pipelines.iter().chain(&experiments);
        let Some(file) = files().find(|file| file.name == name) else {
            let near = did_you_mean(name, files().map(|file| file.name));
            return Err(Error::Config(format!(
                "--copy {name}: no such pipeline or experiment{near}; `pwrfgs pipelines` lists all"
            )));
        };
        let out = PathBuf::from(format!("{name}.ron"));
        check_file_path(&out)?;
        if !write_new(&out, file.text().as_bytes())? {
            return Err(Error::input(&out, "file exists and is not overwritten; rename it, or use another directory"));
        }
        let command = if file.folder == ShippedFile::PIPELINES { "run" } else { "sweep" };
        let (out, purpose) = (out.display(), file.purpose());
        return output::print_result(&format!("{out}: {purpose}\nnext: pwrfgs {command} {out}\n"));
    }
    let row = |file: &&ShippedFile| vec![file.name.to_owned(), file.purpose()];
    let list = |files: &[&ShippedFile]| align_columns(&files.iter().map(row).collect::<Vec<_>>(), 2);
    let models = ShippedModel::all().into_iter().map(|model| vec![model.name.to_owned(), model.purpose.to_owned()]);
    let scenes: Vec<&str> = scenes.iter().map(|file| file.name).collect();
    output::print_result(&format!(
        "{}\nexperiments for `pwrfgs sweep`:\n{}\nmodels for `pwrfgs view`, `predict`, `map`, `locate`, ..:\n{}\n\
         scenes for `pwrfgs simulate`: {}\n",
        list(&pipelines),
        list(&experiments),
        align_columns(&models.collect::<Vec<_>>(), 2),
        scenes.join(", ")
    ))
}

//! `pwrfgs pipelines`: lists the shipped pipelines, or writes one to a file.

use crate::output;
use clap::Args;
use pwrfgs::experiment::text::aligned;
use pwrfgs_core::files::{check_file_place, write_new};
use pwrfgs_core::{Error, Result, ShippedFile, did_you_mean};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Every command that reads a pipeline accepts a name of this list instead of a file. Paths of a named
pipeline, such as data/s23, begin in the current directory. A file of the same name is used first.

EXAMPLES
  pwrfgs pipelines
  pwrfgs run quickstart
  pwrfgs pipelines --copy s23-laptop")]
pub(crate) struct Pipelines {
    /// Write this pipeline to NAME.ron in the current directory
    #[arg(long, value_name = "NAME")]
    pub(crate) copy: Option<String>,
}

pub(crate) fn pipelines(arguments: &Pipelines) -> Result<()> {
    let all = ShippedFile::all(ShippedFile::PIPELINES);
    if let Some(name) = &arguments.copy {
        let Some(file) = all.iter().find(|file| file.name == name) else {
            let near = did_you_mean(name, all.iter().map(|file| file.name));
            return Err(Error::Config(format!("--copy {name}: no such pipeline{near}; `pwrfgs pipelines` lists all")));
        };
        let out = PathBuf::from(format!("{name}.ron"));
        check_file_place(&out)?;
        if !write_new(&out, file.text().as_bytes())? {
            return Err(Error::input(&out, "file exists and is not overwritten; rename it, or use another directory"));
        }
        return output::result(&format!("{}: {}\nnext: pwrfgs run {}\n", out.display(), file.purpose(), out.display()));
    }
    let lines: Vec<_> = all.iter().map(|file| vec![file.name.to_owned(), file.purpose()]).collect();
    let scenes: Vec<&str> = ShippedFile::all(ShippedFile::SCENES).iter().map(|file| file.name).collect();
    let list = aligned(&lines, 2);
    output::result(&format!("{list}scenes for `pwrfgs simulate`: {}\n", scenes.join(", ")))
}

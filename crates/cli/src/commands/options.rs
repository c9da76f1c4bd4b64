//! Arguments that several commands share: pipelines and changes, counts, positions, models and receivers.

use clap::Args;
use pwrfgs::experiment::folder::PIPELINE;
use pwrfgs::experiment::model_file;
use pwrfgs::experiment::sweep::Listing;
use pwrfgs::experiment::text::listed;
use pwrfgs::model::{Ensemble, file};
use pwrfgs_core::messages::strip_control;
use pwrfgs_core::threads::COUNTS;
use pwrfgs_core::{Error, Receiver, Result, did_you_mean, place_fault};
use std::path::{Path, PathBuf};

/// Maximum number of names in an error.
const LISTED: usize = 12;

#[derive(Debug, Args)]
pub(crate) struct ChangeOptions {
    /// Change a setting, such as training.batch=16 or 'split=Random(test: 0.3)'.
    #[arg(
        long = "set",
        value_name = "FIELD=VALUE",
        help = "Change a setting, such as training.batch=16 or\n'split=Random(test: 0.3)'; repeatable; sweep axes override it"
    )]
    set: Vec<String>,
    /// Multiply all step counts, such as 0.25.
    #[arg(
        long,
        value_name = "FACTOR",
        help = "Multiply all step counts, such as 0.25; below 1, also divide the\nlearning rates of masks by it (up to 0.1), so that they still close"
    )]
    scale: Option<f64>,
}

impl ChangeOptions {
    /// Lists the changes of `--set` and `--scale`, each as `FIELD=VALUE`.
    pub(super) fn assignments(&self) -> Vec<String> {
        let scale = self.scale.map(|scale| format!("training.scale={scale:?}"));
        self.set.iter().cloned().chain(scale).collect()
    }
}

/// Returns the pipeline file that `path` is or, as a run folder, contains; also the run folder in the second case.
///
/// # Errors
/// A sweep folder, or another folder without a pipeline.
pub(super) fn resolve_pipeline(path: &Path) -> Result<(PathBuf, Option<PathBuf>)> {
    if !path.is_dir() {
        return Ok((path.into(), None));
    }
    let file = path.join(PIPELINE);
    if file.is_file() {
        return Ok((file, Some(path.into())));
    }
    if let Some(listing) = Listing::read(path)? {
        let problem = "folder of a sweep, expected a pipeline or run folder; repeat `pwrfgs sweep` with the experiment, or name one of its runs";
        return Err(Error::input(path, format!("{problem}: {}", listing.run_names())));
    }
    let why = format!("not a run folder: no {PIPELINE}; name a pipeline file or a run folder");
    Err(Error::input(path, why))
}

/// Parses a number of threads, jobs or seeds; the error states the valid numbers.
pub(crate) fn parse_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if COUNTS.contains(&count) => Ok(count),
        _ => Err(format!("expected a number from {} to {}", COUNTS.start(), COUNTS.end())),
    }
}

/// Parses `N` numbers separated by commas; `None` for other text.
pub(super) fn parse_numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|t| t.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

/// Parses the position `x,y,z` in metres, the value of `option`, which errors name.
pub(super) fn parse_position(option: &str, text: &str) -> Result<[f64; 3]> {
    let wrong =
        || Error::Config(format!("{option} {text}: expected x,y,z in metres, each at most 1e8, such as 3.5,2.2,1.2"));
    parse_numbers(text).filter(|position| place_fault(*position).is_none()).ok_or_else(wrong)
}

/// Reads the models in files or run folders as one ensemble; a file may contain several. Members of several files get
/// numbers as names, and none of these files may have a residual process.
pub(super) fn read_models(paths: &[PathBuf]) -> Result<Ensemble> {
    let read = |path: &PathBuf| file::read_ensemble(&model_file(path)?);
    if let [path] = paths {
        return read(path);
    }
    let files: Vec<Ensemble> = paths.iter().map(read).collect::<Result<_>>()?;
    if let Some(index) = files.iter().position(|file| file.residuals().is_some()) {
        let problem = "has a residual process, which predicts for this model alone; give it as the only model";
        return Err(Error::input(&paths[index], problem));
    }
    let members = files.iter().flat_map(|file| file.members().iter().cloned()).collect();
    Ensemble::new(members).and_then(Ensemble::distinct).map_err(Error::Config)
}

/// Returns the indices of the receivers with these names, in the order of the model; all for no name or `all`. Other
/// names are errors.
pub(super) fn select_receivers(receivers: &[Receiver], names: &[String]) -> Result<Vec<usize>> {
    let index_of = |name: &str| receivers.iter().position(|receiver| receiver.name == name);
    if names.iter().all(|name| name == "all" && index_of(name).is_none()) {
        return Ok((0..receivers.len()).collect());
    }
    let mut chosen = Vec::new();
    for name in names {
        chosen.push(index_of(name).ok_or_else(|| unknown_receiver_error(receivers, name))?);
    }
    chosen.sort_unstable();
    chosen.dedup();
    Ok(chosen)
}

/// Creates the error for the name of an unknown receiver, with the nearest name.
fn unknown_receiver_error(receivers: &[Receiver], name: &str) -> Error {
    let near = did_you_mean(name, receivers.iter().map(|receiver| receiver.name.as_str()));
    let list = listed(receivers.iter().map(|r| strip_control(&r.name)), LISTED);
    Error::Config(format!(
        "--receiver {}: no such receiver in the model{near} (receivers: {list})",
        strip_control(name)
    ))
}

/// Rejects a model or ensemble whose input is not a transmitter position.
pub(super) fn check_position_input(model: &Ensemble) -> Result<()> {
    let mut inputs = model.members().iter().map(|member| member.stages.method.traits().inputs);
    inputs.find(|inputs| *inputs != 3).map_or(Ok(()), |inputs| {
        Err(Error::Config(format!(
            "this model takes {inputs} numbers instead of a transmitter position; score it with `pwrfgs evaluate` on data that \
             have them"
        )))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::Pose;

    #[test]
    fn positions_are_three_finite_numbers() {
        assert_eq!(parse_position("--tx", "1, -2.5,3e0").unwrap(), [1.0, -2.5, 3.0]);
        for wrong in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,NaN", "1,inf,2", "1,2,1e9"] {
            assert!(parse_position("--tx", wrong).unwrap_err().is_input(), "{wrong}");
        }
    }

    #[test]
    fn finds_receivers_by_name_and_suggests_nearest_name() {
        let receivers: Vec<Receiver> = (1..=21).map(|k| Receiver::new(format!("g{k:02}"), Pose::IDENTITY)).collect();
        let select =
            |names: &[&str]| select_receivers(&receivers, &names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>());
        assert_eq!(select(&["g03", "g01", "g03"]).unwrap(), [0, 2]);
        assert_eq!(select(&[]).unwrap().len(), 21);
        assert_eq!(select(&["all"]).unwrap().len(), 21);
        let message = select(&["g3"]).unwrap_err().to_string();
        assert!(message.contains("did you mean `g03`?") && message.contains("and 9 more"), "{message}");
    }
}

//! Models and receivers that a task names.

use pwrfgs_core::messages::strip_control;
use pwrfgs_core::{Error, Receiver, Result, did_you_mean};
use pwrfgs_experiment::{read_model, text::join_names};
use pwrfgs_model::Ensemble;
use std::path::PathBuf;

/// Largest length of the name of a member, bytes.
const LONGEST_NAME: usize = 200;
/// Maximum number of names in an error.
const LISTED: usize = 12;

/// Reads the models in files or run folders, or the shipped models of these names, as one ensemble; a file may contain several.
/// Given several paths, the name of a member is the path of its file, and its name there if the file contains several.
///
/// # Errors
/// A file without a model, models of different scenes, two equal models, or one of several models with a residual process.
pub fn read_models(paths: &[PathBuf]) -> Result<Ensemble> {
    if let [path] = paths {
        return read_model(path);
    }
    let mut members = Vec::new();
    for path in paths {
        let ensemble = read_model(path)?;
        if ensemble.residuals().is_some() {
            let problem = "has a residual process, which predicts for this model alone; give it as the only model";
            return Err(Error::input(path, problem));
        }
        let named = |(name, model): (&String, &pwrfgs_model::Model)| {
            let path = path.display();
            let name = if ensemble.members().len() == 1 { path.to_string() } else { format!("{path}/{name}") };
            (member_name(&name), model.clone())
        };
        members.extend(ensemble.names().iter().zip(ensemble.members()).map(named));
    }
    Ensemble::named(members).and_then(Ensemble::distinct).map_err(Error::Config)
}

/// Returns the name of an ensemble member in a model file, from the path of its model.
fn member_name(path: &str) -> String {
    let name = plain_name(path.trim_matches('/'));
    let start = name.len().saturating_sub(LONGEST_NAME); // paths differ at the end
    name[start..].to_owned()
}

/// Replaces the characters of `text` that names of models and pipelines cannot have by dashes.
pub(crate) fn plain_name(text: &str) -> String {
    text.chars().map(|c| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '-' }).collect()
}

/// Returns the indices of the receivers with these names, in the order of the model; all for no name or `all`.
///
/// # Errors
/// An unknown name; the error has the nearest name.
pub fn select_receivers(receivers: &[Receiver], names: &[String]) -> Result<Vec<usize>> {
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
    let list = join_names(receivers.iter().map(|r| strip_control(&r.name)), LISTED);
    Error::Config(format!(
        "--receiver {}: no such receiver in the model{near} (receivers: {list})",
        strip_control(name)
    ))
}

/// Checks that a transmitter position is the input of all members of a model.
///
/// # Errors
/// The method of a member has another number of inputs than 3.
pub fn check_positions(model: &Ensemble) -> Result<()> {
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

//! Which receivers of a model are meant: `--receiver NAME`.

use pwrfgs::model::Ensemble;
use pwrfgs_core::words::clean;
use pwrfgs_core::{Error, Receiver, Result, did_you_mean};

/// Most names that an error lists.
const LISTED: usize = 12;

/// The receivers of these names, in the model's order; all of them where nothing or `all` is said.
pub(super) fn chosen(known: &[Receiver], names: &[String]) -> Result<Vec<usize>> {
    let place = |name: &str| known.iter().position(|receiver| receiver.name == name);
    if names.iter().all(|name| name == "all" && place(name).is_none()) {
        return Ok((0..known.len()).collect());
    }
    let mut chosen = Vec::new();
    for name in names {
        chosen.push(place(name).ok_or_else(|| unknown(known, name))?);
    }
    chosen.sort_unstable();
    chosen.dedup();
    Ok(chosen)
}

fn unknown(known: &[Receiver], name: &str) -> Error {
    let near = did_you_mean(name, known.iter().map(|receiver| receiver.name.as_str()));
    let list = known.iter().take(LISTED).map(|r| clean(&r.name)).collect::<Vec<_>>().join(", ");
    let more = known.len().saturating_sub(LISTED);
    let list = if more > 0 { format!("{list} and {more} more") } else { list };
    Error::Config(format!(
        "--receiver {}: the model knows no receiver of this name{near}; it knows {list}",
        clean(name)
    ))
}

/// Refuses models that are not asked by position.
pub(super) fn check_positions(model: &Ensemble) -> Result<()> {
    match model.members().iter().map(|member| member.stages.method.traits().inputs).find(|inputs| *inputs != 3) {
        None => Ok(()),
        Some(inputs) => Err(Error::Config(format!(
            "this model is told {inputs} numbers in place of a transmitter's position, so that there is nothing to ask of \
             a position; `pwrfgs evaluate` scores it on data that have them"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::Pose;

    #[test]
    fn receivers_are_found_by_name_and_the_nearest_is_told() {
        let known: Vec<Receiver> = (1..=21).map(|k| Receiver::new(format!("g{k:02}"), Pose::IDENTITY)).collect();
        let chosen = |names: &[&str]| chosen(&known, &names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>());
        assert_eq!(chosen(&["g03", "g01", "g03"]).unwrap(), [0, 2]);
        assert_eq!(chosen(&[]).unwrap().len(), 21);
        assert_eq!(chosen(&["all"]).unwrap().len(), 21);
        let said = chosen(&["g3"]).unwrap_err().to_string();
        assert!(said.contains("did you mean `g03`?") && said.contains("and 9 more"), "{said}");
    }
}

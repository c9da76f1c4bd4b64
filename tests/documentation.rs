//! What the program says of itself comes from the source: every plugin, setting and field has its words there.
use crate::common::OF_TESTS;
use pwrfgs::core::docs::{Body, Docs, Documented, Field, Kind};
use pwrfgs::core::plugin::Family;
use pwrfgs::experiment::sweep::Experiment;
use pwrfgs::prelude::*;
use std::collections::BTreeSet;

/// Looks at a type and at all types of its fields.
fn look(docs: &'static Docs, seen: &mut BTreeSet<&'static str>, faults: &mut Vec<String>) {
    if !seen.insert(docs.name) {
        return;
    }
    if docs.text.trim().is_empty() {
        faults.push(format!("{} says nothing", docs.name));
    }
    match docs.body {
        Body::Fields(fields) => fields.iter().for_each(|f| look_at_field(docs.name, f, seen, faults)),
        Body::Variants(variants) => {
            for variant in variants {
                if variant.text.trim().is_empty() {
                    faults.push(format!("{}::{} says nothing", docs.name, variant.name));
                }
                let named = variant.fields.iter().filter(|_| variant.named);
                named.for_each(|f| look_at_field(variant.name, f, seen, faults));
            }
        }
    }
}

fn look_at_field(owner: &str, field: &Field, seen: &mut BTreeSet<&'static str>, faults: &mut Vec<String>) {
    let place = format!("{owner}.{}", field.name);
    let text = field.text.to_lowercase();
    if text.trim().is_empty() {
        faults.push(format!("{place} says nothing"));
    }
    // The default is printed from the code; a number beside it in words would be kept by hand.
    if text.contains("default") {
        faults.push(format!("{place} speaks of its default; the reference prints it from the code"));
    }
    let units = [("_m", "metre"), ("_deg", "degree"), ("_hz", "hz"), ("_db", "db"), ("_wavelengths", "wavelength")];
    for (suffix, unit) in units {
        if field.name.ends_with(suffix) && !text.contains(unit) {
            faults.push(format!("{place} does not name its unit ({unit})"));
        }
    }
    kind(&place, &(field.kind)(), seen, faults);
}

fn kind(place: &str, it: &Kind, seen: &mut BTreeSet<&'static str>, faults: &mut Vec<String>) {
    match it {
        Kind::Of(docs) => look(docs, seen, faults),
        Kind::Optional(inner) | Kind::List(inner) | Kind::Map(inner) => kind(place, inner, seen, faults),
        Kind::Tuple(parts) => parts.iter().for_each(|part| kind(place, part, seen, faults)),
        // A type that does not derive `Documented` is told by its name in the source.
        Kind::Plain(words) if words.contains('<') || !(words.contains(' ') || words.to_lowercase() == **words) => {
            faults.push(format!("{place} is a {words}, which does not derive Documented"));
        }
        Kind::Plain(_) => {}
        Kind::Plugin(name) => {
            if !seen.insert(name) {
                return;
            }
            let family = Family::find(name).unwrap_or_else(|| panic!("{name} is no kind of plugins"));
            for member in (family.members)().iter().filter(|m| !OF_TESTS.contains(&m.name)) {
                match member.docs {
                    // Two plugins of different kinds may share a name.
                    Some(docs) => look(docs, &mut BTreeSet::new(), faults),
                    None => faults.push(format!("{name} {} does not derive Documented", member.name)),
                }
            }
        }
    }
}

#[test]
fn every_field_of_every_plugin_and_setting_says_what_it_is() {
    let (mut seen, mut faults) = (BTreeSet::new(), Vec::new());
    kind("a pipeline", &Pipeline::kind(), &mut seen, &mut faults);
    kind("an experiment", &Experiment::kind(), &mut seen, &mut faults);
    assert!(faults.is_empty(), "{faults:#?}");
    let found = ["Training", "Optimizer", "Densify", "Loss", "Schedule", "Readout", "Calibration", "Pruner", "Slurm"];
    assert!(found.iter().all(|name| seen.contains(name)), "{seen:?}");
}

/// A plugin of somebody who derives nothing, and one with a field of a foreign type.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Literal {}

#[typetag::serde]
impl Metric for Literal {
    fn evaluate(&self, _: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        Ok(Vec::new())
    }
}

/// Has a field of a type that says nothing.
#[derive(Clone, Debug, Default, Serialize, Deserialize, Documented)]
#[serde(default, deny_unknown_fields)]
struct Foreign {
    /// How long.
    wait: std::time::Duration,
    /// How often.
    #[serde(skip)]
    hidden: u64,
    /// How many.
    counts: Vec<Option<u8>>,
}

#[test]
fn a_plugin_without_the_derive_is_listed_all_the_same() {
    let members = (Family::find("Metric").unwrap().members)();
    let literal = members.iter().find(|m| m.name == "Literal").unwrap();
    assert!(literal.docs.is_none() && literal.text.as_deref() == Ok("Literal()"));
    let fields = Foreign::kind().docs().unwrap().fields();
    let told: Vec<String> = fields.iter().map(|f| format!("{}: {}", f.name, (f.kind)().words())).collect();
    assert_eq!(told, ["wait: std::time::Duration", "counts: list of whole number or None"]);
    assert!(fields.iter().all(|f| f.optional) && Foreign::default().hidden == 0);
}

//! Documentation of every plugin, setting and field, from the source.
use crate::common::OF_TESTS;
use pwrfgs::core::docs::{DocBody, DocField, DocKind, DocVariant, Docs};
use pwrfgs::core::plugin::PluginFamily;
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
        DocBody::Fields(fields) => fields.iter().for_each(|f| look_at_field(docs.name, f, seen, faults)),
        DocBody::Variants(variants) => {
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

fn look_at_field(owner: &str, field: &DocField, seen: &mut BTreeSet<&'static str>, faults: &mut Vec<String>) {
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
    kind(&place, &field.kind, seen, faults);
}

fn kind(place: &str, it: &DocKind, seen: &mut BTreeSet<&'static str>, faults: &mut Vec<String>) {
    match it {
        DocKind::Of(docs) => look(docs, seen, faults),
        DocKind::Optional(inner) | DocKind::List(inner) | DocKind::Map(inner) => kind(place, inner, seen, faults),
        DocKind::Tuple(parts) => parts.iter().for_each(|part| kind(place, part, seen, faults)),
        DocKind::Plain("value") => faults.push(format!("{place} takes a value whose type its schema does not say")),
        DocKind::Plain(_) => {}
        DocKind::Plugin(name) => {
            if !seen.insert(name) {
                return;
            }
            let family = PluginFamily::find(name).unwrap_or_else(|| panic!("{name} is no kind of plugins"));
            for member in (family.members)().iter().filter(|m| !OF_TESTS.contains(&m.name)) {
                match member.docs {
                    // Two plugins of different kinds may share a name.
                    // A plugin may hold another of its kind.
                    Some(docs) => look(docs, &mut BTreeSet::from([*name]), faults),
                    None => faults.push(format!("{name} {} has no defaults", member.name)),
                }
            }
        }
    }
}

#[test]
fn every_field_of_plugins_and_settings_is_documented() {
    let (mut seen, mut faults) = (BTreeSet::new(), Vec::new());
    kind("a pipeline", &DocKind::Of(Docs::of::<Pipeline>()), &mut seen, &mut faults);
    kind("an experiment", &DocKind::Of(Docs::of::<Experiment>()), &mut seen, &mut faults);
    assert!(faults.is_empty(), "{faults:#?}");
    let found = ["Training", "Optimizer", "Densify", "Loss", "Schedule", "Readout", "Calibration", "Pruner", "Slurm"];
    assert!(found.iter().all(|name| seen.contains(name)), "{seen:?}");
}

/// Fields of every sort.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct Sorts {
    /// How often.
    #[serde(skip)]
    hidden: u64,
    /// How many.
    counts: Vec<Option<u8>>,
    /// Where.
    #[schemars(extend("format" = "path"))]
    folder: Option<std::path::PathBuf>,
    /// Which.
    choice: Choice,
    /// Pairs by name.
    pairs: std::collections::BTreeMap<String, (Real, [bool; 2])>,
    /// Degrees.
    elevation: Option<Elevation>,
    /// Who decides.
    pruner: Option<Plugin<dyn Pruner>>,
}

/// Variants of every sort.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
enum Choice {
    /// The first.
    #[default]
    Alone,
    Silent,
    /// Two numbers.
    Pair(u8, Real),
    /// A name.
    Named {
        /// Its text.
        text: String,
        /// Its count.
        #[serde(default)]
        count: u8,
    },
}

#[test]
fn reads_every_kind_of_field_and_variant_from_schema() {
    let docs = Docs::of::<Sorts>();
    let described: Vec<String> = docs.fields().iter().map(|f| format!("{}: {}", f.name, f.kind.words())).collect();
    assert_eq!(
        described,
        [
            "counts: list of whole number or None",
            "folder: path or None",
            "choice: Choice",
            "pairs: (number, (true or false, true or false)) by name",
            "elevation: two numbers or None",
            "pruner: Pruner or None",
        ]
    );
    assert!(docs.text == "Fields of every sort." && docs.fields().iter().all(|f| f.optional));
    let DocBody::Variants(variants) = &docs.fields()[2].kind.docs().unwrap().body else { panic!("{docs:?}") };
    let described = |v: &DocVariant| {
        let fields: Vec<String> =
            v.fields.iter().map(|f| format!("{} {} {}", f.name, f.kind.words(), f.optional)).collect();
        format!("{} {:?} {} {}", v.name, v.text, v.named, fields.join(", "))
    };
    let mut described: Vec<String> = variants.iter().map(described).collect();
    described.sort();
    assert_eq!(
        described,
        [
            "Alone \"The first.\" false ",
            "Named \"A name.\" true text text false, count whole number true",
            "Pair \"Two numbers.\" false _0 whole number false, _1 number false",
            "Silent \"\" false ",
        ]
    );
}

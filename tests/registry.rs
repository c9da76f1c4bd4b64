//! Laws of every linked plugin: defaults, text and doc comment.
use crate::common::{FOREIGN, OF_TESTS};
use pwrfgs::core::plugin::{PluginEntry, PluginFamily, REMOVED_FIELDS, inventory};
use std::path::Path;

/// The first plugin trait and name after each `#[typetag::serde]` of the sources, such as `Pruner TopK`.
fn in_sources() -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    let mut folders = vec![root.join("crates"), root.join("src")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            if path.is_dir() && !["tests", "target"].contains(&name) {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") && name != "tests.rs" {
                let text = std::fs::read_to_string(&path).unwrap();
                let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
                let plugins = code.split("\n#[typetag::serde]\nimpl ").skip(1);
                found.extend(plugins.map(|rest| rest.split(" {").next().unwrap().replace(" for ", " ")));
            }
        }
    }
    found.sort();
    found
}

fn linked() -> Vec<(&'static PluginFamily, PluginEntry)> {
    let members = |family: &'static PluginFamily| (family.members)().into_iter().map(move |member| (family, member));
    inventory::iter::<PluginFamily>().flat_map(members).filter(|(_, member)| !OF_TESTS.contains(&member.name)).collect()
}

#[test]
fn every_plugin_of_sources_is_linked() {
    let mut names: Vec<String> = linked().iter().map(|(family, m)| format!("{} {}", family.kind, m.name)).collect();
    names.sort();
    assert_eq!(names, in_sources());
    assert!(names.len() > 50, "{names:?}");
}

#[test]
fn plugin_defaults_are_valid_and_round_trip() {
    for (family, member) in linked() {
        let what = format!("{} {}", family.kind, member.name);
        let text = member.text.unwrap_or_else(|why| panic!("{what}: {why}"));
        assert!(text.starts_with(&format!("{}(", member.name)), "{what}: {text}");
        assert_eq!((family.complete)(&text).unwrap(), text, "{what}");
        assert!((family.complete)(&format!("{}(no_such_field: 1)", member.name)).is_err(), "{what}");
    }
}

#[test]
fn every_doc_comment_has_summary_and_valid_example() {
    let mut faults = Vec::new();
    for (family, member) in linked() {
        let what = format!("{} {}", family.kind, member.name);
        let text = member.docs.map_or("", |docs| docs.text);
        let first = text.split("\n\n").next().unwrap_or_default();
        if !first.starts_with(|c: char| !c.is_lowercase()) || !first.ends_with('.') {
            faults.push(format!("{what} does not begin with a sentence: {first:?}"));
        }
        let code: String = text.split("```").skip(1).step_by(2).collect();
        let example = call(&code.replace("\\\"", "\""), member.name);
        if member.name != FOREIGN && example.is_none_or(|example| (family.complete)(&example).is_err()) {
            faults.push(format!("{what} has no example in a code block of its doc comment"));
        }
    }
    assert!(faults.is_empty(), "{faults:#?}");
}

/// `Name(..)` with its matching parenthesis, where `code` has it.
fn call(code: &str, name: &str) -> Option<String> {
    let start = code.find(&format!("{name}("))?;
    let mut depth = 0;
    let end = code[start..].find(|c| {
        depth += i32::from(c == '(') - i32::from(c == ')');
        c == ')' && depth == 0
    })?;
    Some(code[start..=start + end].to_owned())
}

/// A file of another version gets the next step, and no field of today is listed as removed.
#[test]
fn removed_fields_name_next_step() {
    for (plugins, field, step) in REMOVED_FIELDS {
        for plugin in *plugins {
            let of_name = |(_, member): &(&PluginFamily, PluginEntry)| member.name == *plugin;
            let (families, members): (Vec<_>, Vec<_>) = linked().into_iter().filter(of_name).unzip();
            assert!(!families.is_empty(), "{plugin}");
            let docs = members.iter().filter_map(|member| member.docs);
            assert!(docs.clone().all(|docs| docs.field(None, field).is_none()), "{plugin}.{field} exists");
            for family in families {
                let error = (family.complete)(&format!("{plugin}(\n  {field}: 1)")).unwrap_err().to_string();
                let expected = format!(":2:{}: {plugin} has no field `{field}` (removed); {step}", 3 + field.len());
                assert!(error.ends_with(&expected), "{error}");
            }
        }
    }
}

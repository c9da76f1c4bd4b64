//! Names: no two public types of the workspace share one.

use crate::structure::sources;
use std::collections::{BTreeMap, BTreeSet};

/// Names that several public types may share, each with the reason.
const SHARED: &[(&str, &str)] = &[
    ("Channels", "pipelines name the data source so, and the channels of a data set have the same term"),
    ("Random", "pipelines name a split and an initialiser so; plugins of different kinds may share a name"),
];
const KINDS: [&str; 5] = ["enum", "struct", "trait", "type", "union"];

/// Names of the public types that `code` defines, cut-off modules and macros included.
fn public_types(code: &str) -> impl Iterator<Item = &str> {
    code.lines().filter_map(|line| {
        let mut words = line.trim_start().strip_prefix("pub ")?.split_whitespace().skip_while(|word| *word == "unsafe");
        let kind = words.next()?;
        let name = words.next()?.split(|c: char| !c.is_alphanumeric() && c != '_').next()?;
        KINDS.contains(&kind).then_some(name)
    })
}

/// Files of crates and of the root package that define a public type, by its name. A file counts once, since it may define a
/// type per precision.
fn definitions() -> BTreeMap<String, BTreeSet<String>> {
    let mut all: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for source in sources().iter().filter(|source| source.package == "." || source.package.starts_with("crates/")) {
        for name in public_types(&source.code) {
            all.entry(name.into()).or_default().insert(source.name.clone());
        }
    }
    all
}

#[test]
fn finds_public_types_only() {
    let code = "pub struct A<'a>(u8);\npub(crate) struct B;\nstruct C;\n    pub unsafe trait D {\npub fn type_of() {\npub type E = u8;";
    assert_eq!(public_types(code).collect::<Vec<_>>(), ["A", "D", "E"]);
}

#[test]
fn public_types_have_distinct_names() {
    let all = definitions();
    assert!(all.len() > 200, "only {} public types found; correct the scan", all.len());
    let is_listed = |name: &str| SHARED.iter().any(|(listed, _)| *listed == name);
    let shared = all.iter().filter(|(name, files)| files.len() > 1 && !is_listed(name));
    let lines: Vec<String> = shared
        .map(|(name, files)| format!("{name}:\n  {}", files.iter().cloned().collect::<Vec<_>>().join("\n  ")))
        .collect();
    assert!(
        lines.is_empty(),
        "public types share a name; qualify one (`Kind` of documentation: `DocKind`), make it pub(crate), or list the name \
         in SHARED with the reason:\n{}",
        lines.join("\n")
    );
    for (name, reason) in SHARED {
        let count = all.get(*name).map_or(0, BTreeSet::len);
        assert!(count > 1 && !reason.is_empty(), "`{name}` has {count} definitions; remove it from SHARED");
    }
}

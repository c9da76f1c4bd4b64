//! The laws of the tree: dependencies of crates go down, modules of a crate form no circle, and a file has at most 300 code
//! lines.
//!
//! Code lines are lines that are neither blank, nor a comment, nor part of a test.

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

/// Each crate and the crates of this project that it may use. A plugin kind is a crate, a stage is a crate.
const ALLOWED: &[(&str, &[&str])] = &[
    ("core", &[]),
    ("raster", &["core"]),
    ("gpu", &["core"]),
    ("networks", &["core", "gpu"]),
    ("init", &["core"]),
    ("prune", &["core"]),
    ("metrics", &["core"]),
    ("data", &["core"]),
    ("localise", &["core"]),
    ("model", &["core"]),
    ("methods", &["core", "gpu", "networks", "raster"]),
    ("raytrace", &["core", "data"]),
    ("planning", &["core", "data", "raytrace"]),
    ("train", &["core", "model"]),
    ("pipeline", &["core", "data", "init", "methods", "metrics", "model", "train"]),
    ("experiment", &["core", "model", "pipeline", "train"]),
    ("report", &["core", "experiment", "model", "pipeline", "train"]),
    (
        "tasks",
        &["core", "data", "experiment", "localise", "model", "pipeline", "planning", "raytrace", "report", "train"],
    ),
    ("viewer", &["core", "experiment", "localise", "model", "pipeline", "raytrace", "report", "tasks", "train"]),
];
/// Code lines of a file.
const OF_FILE: usize = 300;
/// A Rust file that is no test.
pub(crate) struct Source {
    /// Such as `crates/train`, and `train/trainer` as `["train", "trainer"]`.
    pub(crate) package: String,
    module: Vec<String>,
    pub(crate) name: String,
    pub(crate) code: String,
}

/// `text` without blank lines, comments and items under `#[cfg(test)]`.
fn without_tests(text: &str) -> String {
    let is_code = |line: &&str| !line.trim().is_empty() && !line.trim_start().starts_with("//");
    let lines: Vec<&str> = text.lines().filter(is_code).collect();
    let (mut kept, mut i) = (Vec::new(), 0);
    let indent = |line: &str| line.len() - line.trim_start().len();
    while i < lines.len() {
        let attribute = lines[i].trim();
        if attribute.starts_with("#[cfg(test") || attribute.starts_with("#[cfg(all(test") {
            let item = (i + 1..lines.len()).find(|k| !lines[*k].trim().starts_with("#["));
            let ends = |line: &str| line.ends_with([';', '}', ',']);
            let end = |k: &usize| indent(lines[*k]) == indent(lines[i]) && ends(lines[*k]);
            i = (item.unwrap_or(i)..lines.len()).find(end).unwrap_or(lines.len()) + 1;
        } else {
            kept.push(lines[i]);
            i += 1;
        }
    }
    kept.join("\n")
}

/// The names of modules that exist only in tests.
fn test_modules(text: &str) -> impl Iterator<Item = &str> {
    text.split("#[cfg(test)]")
        .skip(1)
        .filter_map(|rest| rest.trim_start().strip_prefix("mod ")?.split_once(';'))
        .map(|(n, _)| n)
}

/// All Rust files below `folder`, tests and benchmarks excluded.
fn read(package: &str, folder: &Path, module: &[String], found: &mut Vec<Source>) {
    let mut entries: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    let text_of = |path: &Path| std::fs::read_to_string(path).unwrap();
    let sources = entries.iter().filter(|path| path.extension().is_some_and(|e| e == "rs"));
    let roots = ["lib", "main", "mod"];
    let of_tests: BTreeSet<String> = sources
        .clone()
        .filter(|path| roots.contains(&path.file_stem().unwrap().to_str().unwrap()))
        .flat_map(|path| test_modules(&text_of(path)).map(str::to_owned).collect::<Vec<_>>())
        .collect();
    for path in sources {
        let stem = path.file_stem().unwrap().to_str().unwrap();
        if stem == "tests" || of_tests.contains(stem) {
            continue;
        }
        let text = text_of(path);
        let mut own = module.to_vec();
        if !roots.contains(&stem) {
            own.push(stem.to_owned());
        }
        let below = folder.join(stem);
        if below.is_dir() && !roots.contains(&stem) {
            read(package, &below, &own, found);
            let tests: BTreeSet<&str> = test_modules(&text).collect();
            found.retain(|f| {
                f.package != package || !tests.iter().any(|t| f.module == [&own[..], &[(*t).into()]].concat())
            });
        }
        found.push(Source {
            package: package.into(),
            module: own,
            name: path.display().to_string(),
            code: without_tests(&text),
        });
    }
    let is_alone = |path: &Path| path.is_dir() && !path.with_extension("rs").is_file();
    for path in entries.iter().filter(|path| is_alone(path)) {
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        read(package, path, &[module, &[name]].concat(), found);
    }
}

pub(crate) fn sources() -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    for folder in ["crates", "examples"] {
        for entry in std::fs::read_dir(root.join(folder)).unwrap() {
            let path = entry.unwrap().path();
            let name = format!("{folder}/{}", path.file_name().unwrap().to_str().unwrap());
            if path.join("src").is_dir() {
                read(&name, &path.join("src"), &[], &mut found);
            }
        }
    }
    for package in ["python", "fuzz", "."] {
        read(package, &root.join(package).join("src"), &[], &mut found);
    }
    found
}

/// A path that is used, and the name that it gets.
type Import = (Vec<String>, String);

/// The paths of a `use` tree.
fn expand(tree: &str, prefix: &[String], imports: &mut Vec<Import>) {
    let (mut depth, mut start) = (0, 0);
    let mut branch = |branch: &str| {
        let branch = branch.trim();
        if branch.is_empty() {
            return;
        }
        let names =
            |path: &str| path.split("::").map(|n| n.trim().to_owned()).filter(|n| !n.is_empty()).collect::<Vec<_>>();
        if let Some((path, rest)) = branch.split_once('{') {
            return expand(rest.strip_suffix('}').unwrap_or(rest), &[prefix, &names(path)].concat(), imports);
        }
        let (path, alias) = branch.split_once(" as ").unwrap_or((branch, ""));
        let path = [prefix, &names(path)].concat();
        let name = path.iter().rfind(|n| *n != "self").filter(|_| alias.is_empty()).map_or(alias, String::as_str);
        imports.push((path.clone(), name.trim().to_owned()));
    };
    for (i, c) in tree.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                branch(&tree[start..i]);
                start = i + 1;
            }
            _ => {}
        }
    }
    branch(&tree[start..]);
}

/// The paths of `code` that are used, and those that are exported again.
fn imports(code: &str) -> [Vec<Import>; 2] {
    let mut all = [Vec::new(), Vec::new()];
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    for (at, _) in code.match_indices("use ").filter(|(at, _)| !code[..*at].ends_with(is_name)) {
        let before = code[..at].trim_end_matches(' ').lines().last().unwrap_or_default().trim();
        let exported = before == "pub" || (before.starts_with("pub(") && before.ends_with(')'));
        if let Some((tree, _)) = code[at + 4..].split_once(';') {
            expand(tree, &[], &mut all[usize::from(exported)]);
        }
    }
    for start in ["crate::", "super::"] {
        for (at, _) in code.match_indices(start).filter(|(at, _)| !code[..*at].ends_with(|c| is_name(c) || c == ':')) {
            let path = code[at..].split(|c: char| !is_name(c) && c != ':').next().unwrap();
            let path: Vec<String> = path.split("::").map(str::to_owned).filter(|n| !n.is_empty()).collect();
            let name = path.last().unwrap().clone();
            if !["crate", "super"].contains(&&*name) {
                all[0].push((path, name));
            }
        }
    }
    all
}

/// Which file of a package a path means.
struct Modules<'a> {
    files: BTreeMap<Vec<String>, usize>,
    exports: BTreeMap<(Vec<String>, String), Vec<String>>,
    sources: &'a [Source],
}

impl Modules<'_> {
    /// `path` as it stands in `module`, counted from the root of the crate.
    fn absolute(&self, module: &[String], path: &[String]) -> Option<Vec<String>> {
        let ups = path.iter().take_while(|n| *n == "super").count();
        Some(match path.first()?.as_str() {
            "crate" => path[1..].to_vec(),
            "self" => [module, &path[1..]].concat(),
            "super" => [&module[..module.len().checked_sub(ups)?], &path[ups..]].concat(),
            first if self.files.contains_key(&[module, &[first.to_owned()]].concat()) => [module, path].concat(),
            _ => return None,
        })
    }

    fn file(&self, path: &[String], depth: usize) -> Option<usize> {
        let known = (0..=path.len()).rev().find(|k| self.files.contains_key(&path[..*k]))?;
        let (module, rest) = path.split_at(known);
        let exported = rest.first().and_then(|name| self.exports.get(&(module.to_vec(), name.clone())));
        let further = exported.filter(|_| depth < 6).and_then(|other| self.file(other, depth + 1));
        further.or_else(|| self.files.get(module).copied())
    }

    fn of(sources: &[Source]) -> Modules<'_> {
        let files = sources.iter().enumerate().map(|(i, s)| (s.module.clone(), i)).collect();
        let mut modules = Modules { files, exports: BTreeMap::new(), sources };
        for source in sources {
            for (path, name) in &imports(&source.code)[1] {
                if let Some(target) = modules.absolute(&source.module, path) {
                    modules.exports.insert((source.module.clone(), name.clone()), target);
                }
            }
        }
        modules
    }

    /// The uses that are part of a circle of the modules in one folder. A module is its file and its folder: a name that it
    /// exports again is its own, in whichever of its files the name is defined.
    fn circles(&self) -> Vec<String> {
        let mut uses = Vec::new();
        let mut next: BTreeMap<&[String], BTreeSet<&[String]>> = BTreeMap::new();
        for source in self.sources {
            let [used, _] = imports(&source.code);
            let absolute = used.iter().filter_map(|(path, _)| self.absolute(&source.module, path));
            let files: BTreeSet<usize> = absolute.filter_map(|path| self.file(&path, 0)).collect();
            for other in files.iter().map(|i| &self.sources[*i]).filter(|other| other.module != source.module) {
                let shared = source.module.iter().zip(&other.module).take_while(|(a, b)| a == b).count();
                let [from, to] = [source, other].map(|s| &s.module[..s.module.len().min(shared + 1)]);
                next.entry(from).or_default().insert(to);
                uses.push((from, to, format!("{} uses {}", source.name, other.name)));
            }
        }
        let reaches = |from: &[String], to: &[String]| {
            let (mut seen, mut stack) = (BTreeSet::new(), vec![from]);
            while let Some(module) = stack.pop() {
                stack.extend(next.get(module).into_iter().flatten().filter(|other| seen.insert(**other)));
            }
            seen.contains(to)
        };
        uses.iter().filter(|(from, to, _)| reaches(to, from)).map(|(_, _, words)| words.clone()).collect()
    }
}

#[test]
fn files_are_within_size_limit() {
    for source in &sources() {
        let lines = source.code.lines().count();
        assert!(lines <= OF_FILE, "{}: {lines} code lines; split it by purpose, at most {OF_FILE}", source.name);
    }
}

#[test]
fn modules_use_each_other_in_one_direction() {
    let mut all = sources();
    all.sort_by(|a, b| a.package.cmp(&b.package));
    let circles: Vec<String> =
        all.chunk_by(|a, b| a.package == b.package).flat_map(|sources| Modules::of(sources).circles()).collect();
    let what = "these modules use each other; move what they share to one of them or below them";
    assert!(circles.is_empty(), "{what}:\n  {}", circles.join("\n  "));
}

#[test]
fn finds_circle_through_exported_names() {
    let source = |path: &str, code: &str| Source {
        package: "a".into(),
        module: path.split('/').filter(|n| !n.is_empty()).map(str::to_owned).collect(),
        name: path.into(),
        code: code.into(),
    };
    let mut sources = vec![
        source("", "pub use noise::draw as noise_of;\npub use scene::Receiver;"),
        source("scene", "pub use receiver::Receiver;\nuse crate::noise_of;"),
        source("scene/receiver", "pub struct Receiver;"),
        source("noise", "use crate::Receiver;\npub fn draw() {}"),
    ];
    assert_eq!(Modules::of(&sources).circles(), ["scene uses noise", "noise uses scene/receiver"]);
    sources[1].code = "pub use receiver::Receiver;".into();
    assert!(Modules::of(&sources).circles().is_empty());
}

#[test]
fn crate_dependencies_match_architecture_diagram() {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let output = Command::new(cargo)
        .args(["metadata", "--no-deps", "--offline", "--format-version", "1"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut seen = 0;
    for package in metadata["packages"].as_array().unwrap() {
        let Some(name) = package["name"].as_str().unwrap().strip_prefix("pwrfgs-") else { continue };
        let Some((_, allowed)) = ALLOWED.iter().find(|(n, _)| *n == name) else { continue };
        seen += 1;
        for dependency in package["dependencies"].as_array().unwrap() {
            // Tests may link what they like.
            if dependency["kind"] == "dev" {
                continue;
            }
            if let Some(other) = dependency["name"].as_str().unwrap().strip_prefix("pwrfgs-") {
                assert!(allowed.contains(&other), "pwrfgs-{name} depends on pwrfgs-{other}");
            }
        }
    }
    assert_eq!(seen, ALLOWED.len());
}

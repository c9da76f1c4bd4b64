//! What is linked: known licences, the one registry, and no crate twice but for the reasons in `deny.toml`. `cargo deny` looks
//! at advisories too, which need a data base.

use pwrfgs::core::testing::skipped;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// The text between quotes, all of them.
fn quoted(text: &str) -> BTreeSet<String> {
    text.split('"').skip(1).step_by(2).map(str::to_owned).collect()
}

/// Whether an SPDX expression can be met with licences of `allowed`.
fn is_allowed(expression: &str, allowed: &BTreeSet<String>) -> bool {
    let plain = expression.replace(['(', ')'], "").replace('/', " OR ");
    plain.split(" AND ").all(|all| all.split(" OR ").any(|one| allowed.contains(one.trim())))
}

#[test]
fn licences_sources_and_duplicates_match_deny_toml() {
    let root = env!("CARGO_MANIFEST_DIR");
    let text = |name: &str| std::fs::read_to_string(format!("{root}/{name}")).unwrap();
    let (policy, lock) = (text("deny.toml"), text("Cargo.lock"));
    let list = |name: &str| {
        let from = policy.find(&format!("\n{name} = [")).unwrap();
        policy[from..].split_once("\n]").map_or(&policy[from..], |(list, _)| list).to_owned()
    };
    let allowed = quoted(list("allow").lines().nth(1).unwrap());
    let excused: BTreeSet<String> =
        list("skip").lines().filter_map(|line| quoted(line).into_iter().find(|word| word.contains('@'))).collect();

    let mut versions: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for package in lock.split("[[package]]").skip(1) {
        let field =
            |name: &str| package.split_once(&format!("\n{name} = \"")).map(|(_, rest)| rest.split('"').next().unwrap());
        if let Some(source) = field("source") {
            assert_eq!(source, "registry+https://github.com/rust-lang/crates.io-index", "{package}");
            versions.entry(field("name").unwrap()).or_default().push(field("version").unwrap());
        }
    }
    // All but the newest of a crate; the lock file has them in order of their text.
    let twice = |(name, all): (&&str, &Vec<&str>)| {
        let number = |v: &&str| v.split('.').map(|n| n.parse().unwrap_or(0)).collect::<Vec<u64>>();
        let newest = all.iter().max_by_key(|v| number(v)).copied();
        let older = all.iter().filter(|v| Some(**v) != newest);
        older.map(|version| format!("{name}@{version}")).collect::<Vec<_>>()
    };
    let twice: BTreeSet<String> = versions.iter().flat_map(twice).collect();
    assert_eq!(twice, excused, "crates in more than one version, and those that deny.toml gives a reason for");

    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let target = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    let output = Command::new(cargo)
        .args(["metadata", "--offline", "--format-version", "1", "--filter-platform", &target])
        .current_dir(root)
        .output()
        .unwrap();
    // Offline cargo knows the licences of what it has fetched, which need not be all of the lock file.
    let Ok(metadata) = serde_json::from_slice::<Value>(&output.stdout) else {
        return skipped(&format!("no licences: {}", String::from_utf8_lossy(&output.stderr).trim()));
    };
    for package in metadata["packages"].as_array().unwrap() {
        let licence = package["license"].as_str().unwrap_or_default();
        assert!(is_allowed(licence, &allowed), "{}: `{licence}` is not allowed in deny.toml", package["name"]);
    }
}

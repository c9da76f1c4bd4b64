//! Linked crates: known licences, one registry, and no crate twice but for the reasons in `deny.toml`; `cargo deny` also checks
//! advisories. Releases: jobs with rights run no code of others, and tools are pinned.

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

/// A file of the folder `.github`.
fn of_github(name: &str) -> String {
    std::fs::read_to_string(format!("{}/.github/{name}", env!("CARGO_MANIFEST_DIR"))).unwrap()
}

/// Jobs of a workflow: the first line of each is its name.
fn jobs(workflow: &str) -> Vec<String> {
    let (_, jobs) = workflow.split_once("\njobs:\n").unwrap();
    let mut found: Vec<String> = Vec::new();
    for line in jobs.lines().filter(|line| !line.trim_start().starts_with('#')) {
        if line.starts_with("  ") && !line.starts_with("   ") {
            found.push(String::new());
        }
        found.last_mut().unwrap().extend([line.trim(), "\n"]);
    }
    found
}

/// Parts of commands that run code of others: build scripts and packages.
const FOREIGN: [&str; 8] =
    ["pip ", "cargo build", "cargo test", "cargo run", "cargo install", "cargo package", "docker", "python"];

#[test]
fn jobs_with_rights_run_no_code_of_others() {
    let mut with_rights = Vec::new();
    for name in ["ci.yml", "release.yml"] {
        let workflow = of_github(&format!("workflows/{name}"));
        assert!(workflow.contains("\npermissions:\n  contents: read\n"), "{name}: the default must be to read");
        for job in jobs(&workflow).iter().filter(|job| job.contains(": write") || job.contains("token }}")) {
            let (name_of, commands) = job.split_once('\n').unwrap();
            for command in commands.lines() {
                let is_foreign = FOREIGN.iter().any(|part| command.contains(part));
                let publishes = command.contains("cargo publish") && !command.contains("--no-verify");
                assert!(!is_foreign && !publishes, "{name}, {name_of} {command}");
            }
            with_rights.push(name_of.to_owned());
        }
    }
    assert_eq!(with_rights, ["release:", "crates:", "python:", "pages:"]);
}

#[test]
fn tools_of_release_are_pinned_with_hashes() {
    let workflow = of_github("workflows/release.yml");
    for job in jobs(&workflow) {
        // Packages that a check installs cannot change what is already uploaded.
        let before = job.split("uses: actions/upload").next().unwrap();
        for command in before.lines().filter(|line| line.contains("pip install")) {
            assert!(command.contains("--require-hashes") || command.contains("--no-index"), "{command}");
        }
    }
    for name in ["build", "check", "site"] {
        let lock = of_github(&format!("release/{name}.txt"));
        let pinned: BTreeSet<&str> = lock
            .split("\n\n")
            .flat_map(str::lines)
            .filter(|line| line.contains("==") && line.ends_with('\\'))
            .map(|line| line.split("==").next().unwrap())
            .collect();
        assert!(lock.matches("--hash=sha256:").count() >= pinned.len());
        let wanted = of_github(&format!("release/{name}.in"));
        for line in wanted.lines().filter(|line| !line.starts_with('#')) {
            let tool = line.split(['[', '=', '>']).next().unwrap();
            assert!(pinned.contains(tool), "{name}.txt does not pin {tool}");
        }
    }
    let release = jobs(&workflow).into_iter().find(|job| job.starts_with("release:")).unwrap();
    let steps = ["sha256sum -- *", "uses: actions/attest-build-provenance@", "gh release create"]
        .map(|step| release.find(step));
    assert!(steps.is_sorted() && steps[0].is_some(), "checksums, then the attestation, then the release: {steps:?}");
    let updates = of_github("dependabot.yml");
    for ecosystem in ["github-actions", "cargo", "pip"] {
        assert!(updates.contains(&format!("package-ecosystem: {ecosystem}\n")), "{ecosystem}");
    }
}

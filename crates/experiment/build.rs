//! Stores the commit of the checkout, or of the packaged crate, in the program. Uncommitted changes do not show in it.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Returns the output of a git command in this folder, trimmed; `None` if it fails or is not UTF-8.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}

/// Returns the commit of the checkout, and prints the files whose changes start this script again. `None` without git, without
/// a repository, or in that of another project.
fn checkout_commit() -> Option<String> {
    let root: PathBuf = std::env::current_dir().ok()?.ancestors().nth(2)?.canonicalize().ok()?; // above crates/experiment
    let is_workspace = Path::new(&git(&["rev-parse", "--show-toplevel"])?).canonicalize().ok()? == root;
    // A commit, checkout or pull changes one of these.
    let branch = git(&["rev-parse", "--symbolic-full-name", "HEAD"]).unwrap_or_default();
    for name in ["HEAD", "logs/HEAD", "packed-refs", &branch] {
        let path = git(&["rev-parse", "--path-format=absolute", "--git-path", name])?;
        if is_workspace && Path::new(&path).is_file() {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    git(&["rev-parse", "HEAD"]).filter(|_| is_workspace)
}

/// Returns the commit that cargo stores in a package; `None` outside a package.
fn package_commit() -> Option<String> {
    let text = std::fs::read_to_string(".cargo_vcs_info.json").ok()?;
    Some(text.split("\"sha1\": \"").nth(1)?.split('"').next()?.to_owned())
}

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let version = env!("CARGO_PKG_VERSION");
    match package_commit().or_else(checkout_commit) {
        Some(commit) => {
            println!("cargo::rustc-env=PWRFGS_COMMIT={commit}");
            println!("cargo::rustc-env=PWRFGS_VERSION={version} ({commit:.10})");
        }
        None => println!("cargo::rustc-env=PWRFGS_VERSION={version}"),
    }
}

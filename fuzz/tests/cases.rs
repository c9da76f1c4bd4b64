//! The first cases, as part of all tests; `CONTRIBUTING.md` names the command for more.

use std::process::Command;

#[test]
fn ten_thousand_broken_files_are_told_from_whole_ones() {
    let output = Command::new(env!("CARGO_BIN_EXE_pwrfgs-fuzz")).args(["--cases", "10000"]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

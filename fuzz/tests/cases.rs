//! The first cases, as part of all tests; `CONTRIBUTING.md` names the command for more.

use std::process::Command;

#[test]
fn every_reader_accepts_a_whole_file() {
    let output = Command::new(env!("CARGO_BIN_EXE_pwrfgs-fuzz")).arg("--whole").output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

#[test]
fn rejects_ten_thousand_mutated_files() {
    let output = Command::new(env!("CARGO_BIN_EXE_pwrfgs-fuzz")).args(["--cases", "10000"]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

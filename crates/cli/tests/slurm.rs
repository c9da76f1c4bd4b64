//! `sweep --launcher slurm` on a real cluster of one node; `tests/slurm` has the scripts.

use pwrfgs_core::testing::skipped;
use std::path::Path;
use std::process::Command;

/// What the script exits with where no cluster can run.
const SKIPPED: i32 = 77;

#[test]
fn a_sweep_on_slurm_ends_as_one_without() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/slurm/run.sh");
    let output = Command::new("bash").arg(script).arg(env!("CARGO_BIN_EXE_pwrfgs")).output();
    let output = output.expect("bash is wherever this project is built");
    let said = crate::common::stderr(&output);
    if output.status.code() == Some(SKIPPED) {
        return skipped(said.lines().last().unwrap_or_default());
    }
    assert!(output.status.success(), "{}: {}{said}", output.status, crate::common::stdout(&output));
}

//! `sweep --launcher slurm` on a real cluster of one node; `tests/slurm` has the scripts.

use pwrfgs_core::testing::skipped;
use std::path::Path;
use std::process::Command;

/// What the script exits with where no cluster can run.
const SKIPPED: i32 = 77;

#[test]
fn slurm_sweep_equals_local_sweep() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/slurm/run.sh");
    let output = Command::new("bash").arg(script).arg(env!("CARGO_BIN_EXE_pwrfgs")).output();
    let output = output.expect("bash is wherever this project is built");
    let message = crate::common::stderr(&output);
    if output.status.code() == Some(SKIPPED) {
        return skipped(message.lines().last().unwrap_or_default());
    }
    assert!(output.status.success(), "{}: {}{message}", output.status, crate::common::stdout(&output));
}

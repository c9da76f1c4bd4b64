//! `sweep --launcher slurm` on a real cluster of one node; `tests/slurm` has the scripts.

use pwrfgs_core::Real;
use std::path::Path;
use std::process::Command;

/// What the script exits with where no cluster can run.
const SKIPPED: i32 = 77;

#[test]
fn a_sweep_on_slurm_ends_as_one_without() {
    if size_of::<Real>() > 4 {
        return; // nothing here depends on precision, and once is enough
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/slurm/run.sh");
    // Its words go to the terminal directly: cargo hides what a test that passes prints, and so why one was skipped.
    let status = Command::new("bash").arg(script).arg(env!("CARGO_BIN_EXE_pwrfgs")).status();
    let status = status.expect("bash is wherever this project is built");
    assert!(status.success() || status.code() == Some(SKIPPED), "{status}; what it said stands above");
}

//! One target under libFuzzer; `fuzz/coverage.sh` builds and starts it. `PWRFGS_FUZZ_FILE` names the target's file,
//! `PWRFGS_FUZZ_CORPUS` the folder that gets its seeds.

#![no_main]
#![allow(unsafe_code, clippy::print_stderr, missing_docs)] // libFuzzer's entry points have no mangled names

use libfuzzer_sys::fuzz_target;
use pwrfgs_fuzz::cases::Bench;
use pwrfgs_fuzz::{bench, targets::TARGETS};
use std::sync::OnceLock;

static BENCH: OnceLock<(Bench, usize)> = OnceLock::new();

fn open() -> (Bench, usize) {
    let file = std::env::var("PWRFGS_FUZZ_FILE").unwrap_or_default();
    let target = TARGETS.iter().position(|target| target.file == file);
    let target = target.unwrap_or_else(|| panic!("no target reads `{file}`; see fuzz/src/targets.rs"));
    let folder = tempfile::tempdir().expect("a folder for temporary files").keep();
    bench::make(&folder).expect("the seeds can be made");
    let bench = Bench::open(&folder).expect("the seeds can be read");
    if let Some(corpus) = std::env::var_os("PWRFGS_FUZZ_CORPUS").map(std::path::PathBuf::from) {
        for (i, seed) in bench.seeds(target).iter().enumerate() {
            std::fs::write(corpus.join(format!("seed-{i}")), seed).expect("the corpus can be written");
        }
    }
    (bench, target)
}

fuzz_target!(init: { BENCH.get_or_init(open); }, |bytes: &[u8]| {
    let (bench, target) = BENCH.get_or_init(open);
    if let Some(fault) = bench.try_bytes(*target, bytes, false).expect("the bench can be written") {
        eprintln!("{fault}");
        std::process::abort(); // libFuzzer keeps the file
    }
});

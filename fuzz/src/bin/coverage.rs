//! Runs one target under libFuzzer; `fuzz/coverage.sh` builds and starts it. `PWRFGS_FUZZ_FILE` is the target's file,
//! `PWRFGS_FUZZ_CORPUS` the folder for its seeds.

#![no_main]
#![allow(unsafe_code, missing_docs)] // libFuzzer's entry points have no mangled names

use libfuzzer_sys::fuzz_target;
use pwrfgs_fuzz::{Bench, targets::TARGETS};
use std::sync::OnceLock;

static BENCH: OnceLock<(Bench, usize)> = OnceLock::new();

fn open() -> (Bench, usize) {
    let of = |name: &str| std::env::var(name).unwrap_or_default();
    let target = TARGETS.iter().position(|target| target.file == of("PWRFGS_FUZZ_FILE"));
    let target = target.expect("PWRFGS_FUZZ_FILE names a file of fuzz/src/targets.rs");
    let folder = tempfile::tempdir().expect("a folder for temporary files").keep();
    let bench = Bench::new(&folder).expect("the bench can be made");
    for (i, seed) in bench.seeds(target).iter().enumerate() {
        let path = std::path::Path::new(&of("PWRFGS_FUZZ_CORPUS")).join(format!("seed-{i}"));
        std::fs::write(path, seed).expect("the corpus can be written");
    }
    (bench, target)
}

fuzz_target!(init: { BENCH.get_or_init(open); }, |bytes: &[u8]| {
    let (bench, target) = BENCH.get_or_init(open);
    let fault = bench.try_bytes(*target, bytes, false).expect("the bench can be written");
    assert_eq!(fault, None); // libFuzzer keeps the file
});

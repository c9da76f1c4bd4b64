#!/usr/bin/env bash
# Coverage-guided fuzzing of one file: fuzz/coverage.sh p.ron [arguments of libFuzzer, such as -max_total_time=600]
# The files are those of fuzz/src/targets.rs. Needs a C++ compiler for libFuzzer, but no nightly toolchain.
set -eu
cd "$(dirname "$0")/.."
export PWRFGS_FUZZ_FILE=$1 RAYON_NUM_THREADS=1
export PWRFGS_FUZZ_CORPUS=$PWD/target/coverage/corpus/$1
shift
mkdir -p "$PWRFGS_FUZZ_CORPUS"
# What `cargo fuzz` passes to rustc, without the sanitizers that need nightly.
export RUSTFLAGS="--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
-Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
-Cllvm-args=-sanitizer-coverage-trace-compares"
export CARGO_PROFILE_RELEASE_{OPT_LEVEL=1,DEBUG=line-tables-only,DEBUG_ASSERTIONS=true}
# A target of its own, so that build scripts and macros are without counters.
host=$(rustc -vV | sed -n 's/^host: //p')
cargo build --release -p pwrfgs-fuzz --bin coverage --features coverage --target "$host" --target-dir target/coverage
cd target/coverage
exec "$host/release/coverage" -timeout=10 -rss_limit_mb=4000 -max_len=65536 "$@" "$PWRFGS_FUZZ_CORPUS"

#!/usr/bin/env bash
# All tests, in single and in double precision (where hand-written derivatives are held against central differences).
# Arguments go to cargo, such as --locked or --offline.
set -eu
cd "$(dirname "$0")/.."

echo "== all tests, f32: every formula as it is used"
cargo test "$@" --workspace
echo "== all tests, f64: derivatives against central differences"
cargo test "$@" --workspace --features pwrfgs-core/f64
echo "== all tests passed, f32 and f64"

#!/usr/bin/env bash
# Miri over the one place where threads share mutable memory by hand: the tiles of a picture, crates/raster/src/canvas.rs.
# Needs a nightly toolchain with Miri (rustup +nightly component add miri rust-src); skipped where there is none.
set -eu
cd "$(dirname "$0")/.."

if ! cargo +nightly miri --version >/dev/null 2>&1; then
    echo "== skipped: no nightly toolchain with Miri"
    exit 0
fi
echo "== Miri: threads write the tiles of a picture side by side"
cargo +nightly miri test -p pwrfgs-raster --lib canvas

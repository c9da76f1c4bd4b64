#!/usr/bin/env bash
# All tests: everything in single precision, as the program is used; where formulas are, also in double precision, where
# hand-written derivatives are held against central differences. Ends with what was skipped and why.
# Arguments go to cargo, such as --locked or --offline.
set -eu
cd "$(dirname "$0")/.."

# What waits more than it computes, or takes long, runs beside the rest, and is told at the end.
beside=(example_plugin_is_swept_by_name published_pruners_work_outside_the_workspace slurm_sweep_equals_local_sweep
    run_killed_at_any_write_resumes_to_identical_result
    reports_full_disk_at_any_write_and_run_resumes
    rejects_ten_thousand_mutated_files)
# The program and the Python package are here for their dependencies alone: with them all crates of others are those of the
# first pass, and the Python package in double precision is built of these.
formulas=(-p pwrfgs -p pwrfgs-core -p pwrfgs-methods -p pwrfgs-networks -p pwrfgs-prune -p pwrfgs-raster -p pwrfgs-train -p pwrfgs-cli
    -p pwrfgs-python -p pwrfgs-gpu)
# Networks on a GPU, which is a software GPU here. Compiled with the rest; skipped without a driver.
gpu=(--features pwrfgs/gpu,pwrfgs-cli/gpu)
# Tests of files, texts and whole runs: no formula, so single precision is enough.
once=(baselines:: changes:: determinism:: documentation:: examples:: figures:: inspect:: learning:: maps:: names:: own_baseline::
    pipelines:: registry:: repeatability:: stopping:: streaming:: structure:: supply_chain::)

notes=$(mktemp -d)
export PWRFGS_SKIPPED=$notes/skipped # pwrfgs_core::testing::skipped writes there
failed=()

cargo test "$@" --workspace "${gpu[@]}" --no-run
cargo test "$@" --workspace "${gpu[@]}" --no-fail-fast --test cli --test fuzz -- "${beside[@]}" >"$notes/beside" 2>&1 &
beside_pid=$!
trap 'kill $beside_pid 2>/dev/null || true; rm -r "$notes"' EXIT

echo "== all tests, f32: every formula as it is used"
cargo test "$@" --workspace "${gpu[@]}" --no-fail-fast -- "${beside[@]/#/--skip=}" || failed+=("f32")
echo "== where formulas are, f64: derivatives against central differences"
double=("$@" "${formulas[@]}" --features pwrfgs/f64)
cargo test "${double[@]}" --no-fail-fast --lib --test all -- "${once[@]/#/--skip=}" || failed+=("f64")
echo "== the Python package"
PWRFGS_FORMULAS="${formulas[*]}" PWRFGS_FEATURES="${gpu[*]}" tests/python.sh "$@" || failed+=("the Python package")
echo "== beside them: the example plugin, Slurm, kills and full disks, broken files"
wait $beside_pid || failed+=("what ran beside the rest")
cat "$notes/beside"

if [ -s "$PWRFGS_SKIPPED" ]; then
    echo "== $(wc -l <"$PWRFGS_SKIPPED") checks skipped"
    sort "$PWRFGS_SKIPPED" | uniq -c
fi
if [ ${#failed[@]} -gt 0 ]; then
    printf '== failed: %s\n' "${failed[@]}"
    exit 1
fi
echo "== all tests passed, f32 and f64"

#!/usr/bin/env bash
# `pwrfgs sweep --launcher slurm` against a real Slurm, on a cluster of one node that `cluster.sh` starts and this stops.
#
#   run.sh PWRFGS    the program to test
#
# One sweep runs undisturbed. In a second one a run is killed, one is warned of its time limit and one is requeued while
# they train; handed in once more, all must end as they do without Slurm, byte for byte.
#
# Exit codes: 0 everything holds; 1 something does not; 77 no cluster can run here, the reason is printed.
set -eu

if [ $# != 1 ] || [ ! -x "$1" ]; then
    echo "usage: run.sh PWRFGS" >&2
    exit 1
fi
pwrfgs=$(readlink -f "$1")
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d /tmp/pwrfgs-slurm.XXXXXX) # not $TMPDIR: sockets need a short path
chmod 711 "$work"                          # munge wants its socket within reach of everybody

finish() {
    local code=$?
    trap - EXIT
    if [ $code != 0 ] && [ $code != 77 ]; then
        tail -n 20 "$work"/*/slurm/*/*.log >&2 2>/dev/null || true
    fi
    "$here/cluster.sh" stop "$work/cluster" || true
    rm -rf "$work"
    exit $code
}
trap finish EXIT
trap 'exit 1' INT TERM

fail() { echo "run.sh: $*" >&2; exit 1; }

# check WHAT COMMAND..: the command must succeed.
check() {
    local what=$1
    shift
    "$@" || fail "does not hold: $what"
    echo "ok: $what"
}

# wait_until WHAT COMMAND..: the command must succeed some time; ten minutes are for a machine that hangs.
wait_until() {
    local what=$1 tries=0
    shift
    until "$@"; do
        tries=$((tries + 1))
        [ $tries -le 6000 ] || fail "ten minutes have gone by without: $what"
        sleep 0.1
    done
}

# An experiment of four runs, two variants and two seeds, each of `$2` steps.
experiment() {
    cat >"$work/$1.ron" <<RON
Experiment(
    name: "$1",
    base: "base.ron",
    seeds: [0, 1],
    set: {"training": $2},
    axes: [
        Axis(name: "lambda", variants: [
            (label: "0.01", set: {"pruners": [LearnableMask(lambda: 0.01), OpacityThreshold()]}),
            (label: "0.02", set: {"pruners": [LearnableMask(lambda: 0.02), OpacityThreshold()]}),
        ]),
    ],
    slurm: (cpus: 1, memory: "500M", time: "00:10:00"),
)
RON
}

submit() { "$pwrfgs" sweep "$work/$1.ron" --out "$work/$1" --launcher slurm "${@:2}"; }
status() { "$pwrfgs" sweep "$work/$1.ron" --out "$work/$1" --status; }
all_finished() { status "$1" | grep -q '4 of 4 runs finished'; }
queue_is_empty() { [ -z "$(squeue --noheader)" ]; }

# The tasks that train and have a checkpoint: task, process and run folder, one task a line.
training() {
    local task job pid folder
    squeue --noheader --array --states=RUNNING --format='%F_%K %A' | while read -r task job; do
        for pid in $(scontrol listpids "$job" 2>/dev/null | awk 'NR > 1 { print $1 }'); do
            [ "$(readlink "/proc/$pid/exe" 2>/dev/null)" = "$pwrfgs" ] || continue
            # The run holds its pipeline open, as a lock.
            folder=$(find "/proc/$pid/fd" -lname '*/pipeline.ron' -printf '%l\n' -quit 2>/dev/null)
            folder=${folder%/pipeline.ron}
            if [ -e "$folder/checkpoint.safetensors" ] && [ ! -e "$folder/model.safetensors" ]; then
                echo "$task $pid $folder"
            fi
        done
    done
}

# Those among them that were not disturbed yet, at least `$1`.
fresh() {
    training | grep -vF "$disturbed" >"$work/fresh" || true
    [ "$(wc -l <"$work/fresh")" -ge "$1" ]
}

# The file that only a start from nothing writes.
first_step() { stat -c '%i %y %n' "$1/start.safetensors"; }

# Notes a run that is about to be disturbed.
disturb() {
    disturbed+=$'\n'$1
    begun+=$'\n'$(first_step "$1")
}

# Rows of a curve without the seconds.
curve() { sed 's/,[^,]*$//' "$1/curve.csv"; }

starts() { sed -n 's/.*"starts": *\([0-9]*\).*/\1/p' "$1/run.json"; }

same_run() {
    local name
    for name in model.safetensors start.safetensors unpruned.safetensors validation.csv samples.csv; do
        cmp "$1/$name" "$2/$name" || return 1
    done
    [ "$(curve "$1")" = "$(curve "$2")" ]
}

same_sweep() {
    local run count=0
    for run in "$1"/*/run.json; do
        run=$(basename "$(dirname "$run")")
        same_run "$1/$run" "$2/$run" || return 1
        count=$((count + 1))
    done
    [ $count = 4 ]
}

cat >"$work/base.ron" <<'RON'
Pipeline(
    name: "small",
    data: Teacher(gaussians: 4, samples: 40, width: 48, height: 12),
    split: Official(validation: 0.2),
    initializer: Grid(count: 8),
    deformation: Mlp(depth: 2, width: 16, skip: None),
)
RON
experiment short "(steps: 60, batch: 2, densify_until: 20, prune_until: 40, prune_every: 10, validate_every: 20)"
experiment long "(steps: 4_000, batch: 2, densify_until: 1_500, prune_until: 3_000, prune_every: 150,
        validate_every: 300, checkpoint_every: 70, densify: (every: 100, from: 100, max_gaussians: 60))"

"$here/cluster.sh" start "$work/cluster" >"$work/environment"
# shellcheck source=/dev/null
. "$work/environment"

submit short --shard 1/2 &
submit short --shard 2/2
wait $!
check "shards submitted at once submit each run once" test "$(cat "$work"/short/slurm/*/runs.txt | sort | uniq -c | grep -c ' 1 ')" = 4
check "the runs of a sweep stand in Slurm's queue" test "$(squeue --noheader --array | wc -l)" -gt 0
wait_until "a sweep finished" all_finished short
wait_until "an empty queue" queue_is_empty
check "a finished sweep has nothing to submit" grep -q 'nothing to submit' <(submit short)

submit long
check "what Slurm has is not submitted twice" grep -q 'nothing to submit: 4 runs' <(submit long)
disturbed=none begun=
wait_until "two runs at work" fresh 2
{ read -r _ killed_pid killed; read -r requeued_task _ requeued; } <"$work/fresh"
disturb "$killed"
disturb "$requeued"
kill -KILL "$killed_pid"
scontrol requeue "$requeued_task"
wait_until "the other two runs at work" fresh 2
# The task that starts last has the job id of the whole array: what it does to itself must not reach its neighbours.
sort -V "$work/fresh" >"$work/sorted"
{ read -r _ _ left; read -r _ warned_pid warned; } <"$work/sorted"
disturb "$warned"
# What Slurm sends to the script before the time limit. Not by scancel, which may send it once more to the next start.
kill -USR1 "$(awk '/^PPid:/ { print $2 }' "/proc/$warned_pid/status")"
wait_until "an empty queue" queue_is_empty
status long
check "all runs but the killed one have finished" grep -q '3 of 4 runs finished' <(status long)
check "--status names the killed run as stopped" grep -q "$(basename "$killed") *stopped" <(status long)
check "the same command submits the killed run alone" grep -q 'submitted 1 run' <(submit long)
wait_until "the sweep finished" all_finished long
status long

for run in "$killed" "$requeued" "$warned"; do
    check "$(basename "$run"), disturbed, took two starts" test "$(starts "$run")" = 2
done
check "$(basename "$left"), left in peace, took one" test "$(starts "$left")" = 1
check "none began again from nothing" test "$(for run in "$killed" "$requeued" "$warned"; do first_step "$run"; done)" = \
    "${begun#?}"
"$pwrfgs" sweep "$work/long.ron" --out "$work/local" --jobs 2 --quiet >"$work/local.txt"
check "every run ends in the same bytes as without Slurm" same_sweep "$work/local" "$work/long"

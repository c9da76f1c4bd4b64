#!/usr/bin/env bash
# A Slurm cluster of one node, everything of it inside one folder: for tests, on any Debian machine or container.
#
#   cluster.sh start DIR    prints `export SLURM_CONF=DIR/slurm.conf` once jobs can run; the rest goes to stderr
#   cluster.sh stop DIR     cancels what runs, ends the three daemons; logs stay in DIR/log
#
# Exit codes: 0 done; 1 failed; 77 no cluster can run here, the reason is printed.
# Needs root (slurmd starts jobs as their users) but neither systemd nor control groups. Ports and sockets are its own, so
# that a cluster already on the machine does not notice.
set -eu
PATH=$PATH:/usr/sbin:/sbin

PACKAGES=(slurmctld slurmd slurm-client munge)
PROGRAMS=(munged slurmctld slurmd sbatch scontrol sinfo squeue scancel)
DAEMONS=(munged slurmctld slurmd) # in the order of their start

say() { echo "cluster.sh: $*" >&2; }
skip() { say "no Slurm cluster here: $*"; exit 77; }
fail() { say "$*"; exit 1; }

missing() {
    local program
    for program in "${PROGRAMS[@]}"; do
        command -v "$program" >/dev/null || echo "$program"
    done
}

# A port of this machine on which nobody listens; by chance, so that clusters started together do not meet.
free_port() {
    local port
    while port=$((10000 + RANDOM % 20000)); (: <>"/dev/tcp/127.0.0.1/$port") 2>/dev/null; do :; done
    echo "$port"
}

configure() {
    local dir=$1 host
    host=$(hostname -s 2>/dev/null || uname -n)
    # The daemons compare the machine's name with the one here and never look up its address, which may have none.
    # Two processors and 2 GB whatever the machine has, so that two of four tasks wait everywhere.
    # cred_expire is also how long a requeued job must wait; the other times are short for the same reason.
    cat >"$dir/slurm.conf" <<CONF
ClusterName=pwrfgs-test
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$(free_port)
SlurmdPort=$(free_port)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$dir/run/munge.socket,cred_expire=5
StateSaveLocation=$dir/state
SlurmdSpoolDir=$dir/spool
SlurmctldPidFile=$dir/run/slurmctld.pid
SlurmdPidFile=$dir/run/slurmd.pid
SlurmctldLogFile=$dir/log/slurmctld.log
SlurmdLogFile=$dir/log/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
SwitchType=switch/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SchedulerType=sched/backfill
SchedulerParameters=sched_interval=1,bf_interval=1,batch_sched_delay=0
SlurmdParameters=config_overrides
ReturnToService=2
JobRequeue=1
KillWait=5
MinJobAge=60
SlurmctldTimeout=10
SlurmdTimeout=30
InactiveLimit=0
NodeName=node1 NodeHostname=$host NodeAddr=127.0.0.1 CPUs=2 RealMemory=2048 State=UNKNOWN
PartitionName=test Nodes=node1 Default=YES MaxTime=INFINITE State=UP
CONF
    # No control groups. Before 23.11 there is no word for none; the first version, once named, is left alone.
    local groups=disabled
    [ "$(slurmd -V | sed 's/[^0-9]*\([0-9]*\)\.\([0-9]*\).*/\1\2/')" -ge 2311 ] || groups=cgroup/v1
    echo "CgroupPlugin=$groups" >"$dir/cgroup.conf"
}

# Starts a daemon in the foreground, in a session of its own, and notes its process.
launch() {
    local dir=$1 name=$2
    shift 2
    setsid "$@" >>"$dir/log/$name.out" 2>&1 </dev/null &
    echo $! >"$dir/run/$name"
}

# Whether a daemon runs; one that ended stays a zombie where the container's first process reaps nobody.
alive() {
    local pid
    pid=$(cat "$1/run/$2" 2>/dev/null) && grep -q '^State:[[:space:]]*[^ZX[:space:]]' "/proc/$pid/status" 2>/dev/null
}

# Waits for a condition up to `$1` seconds, as long as all daemons live.
wait_for() {
    local dir=$1 seconds=$2 name tenths=0
    shift 2
    until "$@" >/dev/null 2>&1; do
        for name in "${DAEMONS[@]}"; do
            [ ! -e "$dir/run/$name" ] || alive "$dir" "$name" || return 1
        done
        tenths=$((tenths + 1))
        [ "$tenths" -le $((seconds * 10)) ] || return 1
        sleep 0.1
    done
}

# What the daemons last said.
explain() {
    tail -n 5 "$1"/log/*.out >&2 || true
}

node_is_idle() { [ "$(sinfo --noheader --format=%T 2>/dev/null)" = idle ]; }

start() {
    local dir=$1
    [ "$(id -u)" = 0 ] || skip "slurmd must be started by root"
    [ -z "$(missing)" ] || skip "$(missing | xargs) missing; .ci/run installs ${PACKAGES[*]}"
    [ ! -e "$dir/slurm.conf" ] || fail "$dir holds a cluster already; stop it and remove the folder"
    mkdir -p "$dir/log" "$dir/run" "$dir/state" "$dir/spool"
    dir=$(cd "$dir" && pwd -P)
    # A socket's path has at most 107 bytes, and slurmd adds the node and the job to the folder.
    [ ${#dir} -le 64 ] || fail "the path $dir is too long for sockets; give one of at most 64 characters"
    chmod 755 "$dir" "$dir/run"
    chmod 700 "$dir/log" "$dir/state"
    configure "$dir"
    export SLURM_CONF=$dir/slurm.conf
    (umask 077 && head -c 128 /dev/urandom >"$dir/munge.key")
    trap 'explain "$dir"; stop "$dir"' EXIT
    launch "$dir" munged munged --foreground --origin=127.0.0.1 --key-file="$dir/munge.key" \
        --socket="$dir/run/munge.socket" --pid-file="$dir/run/munged.pid" --seed-file="$dir/run/munged.seed" \
        --log-file="$dir/log/munged.log"
    wait_for "$dir" 20 munge --no-input --socket="$dir/run/munge.socket" || fail "munged does not start"
    launch "$dir" slurmctld slurmctld -D -f "$SLURM_CONF"
    wait_for "$dir" 20 scontrol ping || fail "slurmctld does not start"
    launch "$dir" slurmd slurmd -D -N node1 -f "$SLURM_CONF"
    wait_for "$dir" 30 node_is_idle || fail "the node does not become idle: $(sinfo --noheader --format='%T %E' 2>&1)"
    trap - EXIT
    say "$(sinfo --version) is ready, logs in $dir/log"
    echo "export SLURM_CONF=$SLURM_CONF"
}

# Processes that this cluster's jobs left behind: slurmstepd and what it started carry its configuration in their
# environment, and a step's daemon its name or a job its number.
job_processes() {
    local folder environment
    for folder in /proc/[0-9]*; do
        environment=$({ tr '\0' '\n' <"$folder/environ"; } 2>/dev/null) || continue
        grep -qxF "SLURM_CONF=$1/slurm.conf" <<<"$environment" || continue
        if grep -q '^SLURM_JOB_ID=' <<<"$environment" || [ "$(cat "$folder/comm" 2>/dev/null)" = slurmstepd ]; then
            echo "${folder#/proc/}"
        fi
    done
}

no_jobs() { [ -z "$(squeue --noheader 2>/dev/null)" ]; }
gone() { ! alive "$1" "$2"; }

stop() {
    local dir name pid i
    dir=$(cd "$1" 2>/dev/null && pwd -P) || return 0
    export SLURM_CONF=$dir/slurm.conf
    if alive "$dir" slurmctld && alive "$dir" slurmd && ! no_jobs; then
        scancel --user="$(id -un)" >/dev/null 2>&1 || true
        wait_for "$dir" 15 no_jobs || true
    fi
    for ((i = ${#DAEMONS[@]} - 1; i >= 0; i--)); do
        name=${DAEMONS[i]}
        alive "$dir" "$name" || continue
        pid=$(cat "$dir/run/$name")
        kill -TERM "$pid" 2>/dev/null || true
        # In `/` no daemon is expected to live meanwhile.
        wait_for / 10 gone "$dir" "$name" || kill -KILL "$pid" 2>/dev/null || true
    done
    for pid in $(job_processes "$dir"); do
        kill -KILL "$pid" 2>/dev/null || true
    done
    rm -rf "$dir/run" "$dir/slurm.conf"
}

case "${1:-} $#" in
    "start 2") start "$2" ;;
    "stop 2") stop "$2" ;;
    *) fail "usage: cluster.sh start|stop DIR" ;;
esac

#!/usr/bin/env bash
# On a machine with a GPU: the tests of networks and of drawing on it, then a table in Markdown of the times of whole training steps,
# CPU beside GPU. About a minute after compilation. Without a GPU, on the software adapter of Debian's mesa-vulkan-drivers, whose
# times say nothing.
# Arguments: the number of steps, by default 200; the largest number of Gaussians, by default 65,469 (a software adapter takes
# minutes for it); the Cargo profile, by default release.
set -eu
cd "$(dirname "$0")/.."
steps=${1:-200}
most=${2:-65469}
profile=${3:-release}
export PWRFGS_DEVICE_SOFTWARE=1
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-/tmp} # Mesa complains without it

cargo test --profile "$profile" -p pwrfgs-gpu --lib
cargo test --profile "$profile" -p pwrfgs-networks -p pwrfgs-methods --features pwrfgs-methods/gpu --lib -- gpu resident
cargo test --profile "$profile" -p pwrfgs-cli --features gpu --test cli gpu::
cargo run --profile "$profile" -p pwrfgs --features gpu --example device_times -- "$steps" "$most"

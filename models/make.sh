#!/bin/sh
# Trains the shipped models again, compresses and scores them (models/README.md). From the root of the repository, with data in
# data/s23 and data/ble (docs/data.md) and `pwrfgs` on the PATH; about 10 minutes of one core with a release build:
#   models/make.sh OUT
# OUT then has the runs, the models NAME.safetensors and their scores NAME.txt. Another processor gives other digits. To ship new
# files, copy them to models/ and renew digests, predictions and scores in tests/models.rs and models/README.md.
set -eu
out=$1
mkdir -p "$out"

# Narrower than in s23-laptop, and without correlations with the training positions, which the file would hold. Jitter and decay are
# those of experiments/size.ron.
pwrfgs run s23-laptop --threads 1 --out "$out/s23" \
    --set 'deformation=Factored(depth: 5, width: 224, tx_encoding: Waves(count: 64, reach: 24.0), position_encoding: Waves(count: 16, reach: 4.0))' \
    --set training.tx_jitter_m=0.01 --set training.optimizer.network_decay=0.02
pwrfgs run ble --threads 1 --out "$out/ble"
pwrfgs run office-channel --threads 1 --out "$out/office-channel"

pwrfgs compress "$out/s23" --out "$out/s23.safetensors"
pwrfgs compress "$out/ble" --out "$out/ble.safetensors"
# Positions in 16 bits would turn the phases at 2.4 GHz.
cp "$out/office-channel/model.safetensors" "$out/office-channel.safetensors"

for name in s23 ble office-channel; do
    pwrfgs evaluate "$out/$name.safetensors" --pipeline "$out/$name/pipeline.ron" > "$out/$name.txt"
done

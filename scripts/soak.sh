#!/usr/bin/env bash
# Three soaks, one after the other. Each says what it did and fails when something was wrong.
#
#   SOAK_SECONDS=300   hostile uploads against a daemon whose address space is limited to 2 GiB, beside frames that go on being answered
#   SOAK=30m           a cluster under load and faults (scripts/soak.py): 90s, 30m, 8h
#   SOAK_SEED=…        the order of events of an earlier soak; a random one by default
set -euo pipefail
cd "$(dirname "$0")/.."

export SOAK_SECONDS="${SOAK_SECONDS:-300}"
read -ra features <<<"$(scripts/features.sh)"
cargo test --release --locked "${features[@]}" --test http -- --exact soak::hostile_uploads_never_lose_the_daemon --nocapture

scripts/setup-nats.sh
# A debug build: it checks for overflows, and loses its device when the soak tells it to.
cargo build --locked "${features[@]}"
scripts/soak.py --program target/debug/pointillist --time "${SOAK:-30m}" ${SOAK_SEED:+--seed "$SOAK_SEED"}
# A film over three workers that survives ten kills of workers, daemon and broker, with the checksums of one process.
scripts/cluster.py kills --program target/debug/pointillist --frames 150 ${SOAK_SEED:+--seed "$SOAK_SEED"}

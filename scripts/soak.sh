#!/usr/bin/env bash
# Five minutes (SOAK_SECONDS) of hostile uploads against a daemon whose address space is limited to 2 GiB, beside frames that go on being
# answered. Fails when the daemon is lost, when a frame is wrong, or when memory does not come back.
set -euo pipefail
cd "$(dirname "$0")/.."

export SOAK_SECONDS="${SOAK_SECONDS:-300}"
# shellcheck disable=SC2046 # no words, or two
cargo test --release --locked $(scripts/features.sh) --test http -- --exact soak::hostile_uploads_never_lose_the_daemon --nocapture

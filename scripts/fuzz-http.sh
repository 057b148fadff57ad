#!/usr/bin/env bash
# Tests openapi.yaml and a daemon of the debug build against each other.
#
#   scripts/fuzz-http.sh "$(scripts/setup-python.sh)" --seconds 75 | --cases 10000
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

python=${1:?the folder that scripts/setup-python.sh prints}
shift
# Whether the daemon can make videos: what it cannot do is no fault of the contract.
video=0
case $(scripts/features.sh 2>/dev/null) in *video*) video=1 ;; esac
CONTRACT_VIDEO=$video exec "$python/bin/python" tests/contract/run.py target/debug/pointillist "$@"

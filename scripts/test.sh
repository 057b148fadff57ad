#!/usr/bin/env bash
# Everything that must hold before a change lands; `make test` and CI run this and nothing else.
#
# Each stage runs whatever the ones before it said, so that one run shows every fault. The last line
# counts tests and other checks together: `N passed, N failed, N skipped`.
set -uo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 1
logs=target/test-logs
mkdir -p "$logs"
passed=0 failed=0 skipped=0
failures=()

headline() { printf '\n== %s\n' "$*"; }

# One check that counts once.
check() { # NAME COMMAND…
    local name=$1 began=$SECONDS
    shift
    headline "$name"
    if "$@"; then
        echo "ok: $name ($((SECONDS - began)) s)"
        passed=$((passed + 1))
    else
        echo "FAILED: $name ($((SECONDS - began)) s)"
        failed=$((failed + 1))
        failures+=("$name")
    fi
}

skip() { # NAME REASON
    headline "$1"
    printf '!! SKIPPED: %s: %s\n' "$1" "$2"
    skipped=$((skipped + 1))
}

# Sums up what cargo test and nextest say at the end of each run.
count() { # LOG → "passed failed skipped"
    # Colours are off in a log, but nextest may be configured otherwise.
    sed 's/\x1b\[[0-9;]*m//g' "$1" | awk '
        /^test result:/ { for (i = 2; i <= NF; i++) {
            if ($i == "passed;") p += $(i-1); if ($i == "failed;") f += $(i-1); if ($i == "ignored;") s += $(i-1) } }
        /^ *Summary \[/ { for (i = 2; i <= NF; i++) { w = $i; sub(/[,)]+$/, "", w); n = $(i-1); sub(/^\(/, "", n)
            if (w == "passed") p += n
            if (w == "failed" || w == "timed") f += n
            if (w == "skipped") s += n } }
        END { print p + 0, f + 0, s + 0 }'
}

# A test runner, whose tests count one by one. Not having run counts as one failure.
tests() { # NAME COMMAND…
    local name=$1 began=$SECONDS status log p f s
    log=$logs/${1// /-}.log
    shift
    headline "$name"
    "$@" 2>&1 | tee "$log"
    status=${PIPESTATUS[0]}
    read -r p f s < <(count "$log")
    if [ "$status" -ne 0 ] && [ "$f" -eq 0 ]; then f=1; fi
    if [ "$f" -gt 0 ]; then failures+=("$name"); fi
    passed=$((passed + p)) failed=$((failed + f)) skipped=$((skipped + s))
    echo "$name: $p passed, $f failed, $s ignored ($((SECONDS - began)) s)"
}

export CARGO_TERM_COLOR=never
# What this machine can build, the same as `make build` makes.
read -ra features <<<"$(scripts/features.sh)"
[ "${#features[@]}" -gt 0 ] || skip "video" "no C++ compiler; tests of the built-in H.264 coder are left out"

check "cargo fmt" cargo fmt --check
check "cargo clippy" cargo clippy --quiet --all-targets --locked "${features[@]}" -- -D warnings

# Sets up a tool that tests use. Where that works, the tests may not skip themselves.
tool() { # NAME SETUP VARIABLE REASON
    if "$2" 2>&1; then
        export "$3=required"
    else
        skip "$1" "$4"
    fi
}
tool "browser" scripts/setup-browser.sh POINTILLIST_BROWSER \
    "no Chromium with chromedriver; tests/browser.rs skips itself"
tool "servers" scripts/setup-servers.sh POINTILLIST_SERVERS \
    "no HAProxy, nginx or Prometheus; tests/http/balancer.rs and monitoring.rs skip themselves"
tool "nats-server" scripts/setup-nats.sh POINTILLIST_NATS_SERVER \
    "none here; tests/http/cluster.rs skips itself"

# Python's tools: moto's S3 service, the checker of Kubernetes manifests, and schemathesis.
python=$(scripts/setup-python.sh) || python=
export POINTILLIST_PYTHON=${python:+$python/bin/python}

data=${POINTILLIST_DATA:-../shared/data}
[ -d "$data" ] || skip "real data" "no folder $data (POINTILLIST_DATA); tests that read real files skip themselves"

if cargo nextest --version >/dev/null 2>&1; then
    check "build of tests" cargo nextest run --no-run --cargo-quiet --locked "${features[@]}"
    run=(cargo nextest run --locked "${features[@]}" --no-fail-fast --success-output never)
    tests "cargo nextest" "${run[@]}" -E 'not binary(twin)'
    # CI stops after 90 minutes. A machine that is late runs a part of the twin tests, chosen by their names.
    part=1
    if [ "$SECONDS" -gt $((70 * 60)) ]; then part=8; elif [ "$SECONDS" -gt $((45 * 60)) ]; then part=3; fi
    [ "$part" -eq 1 ] || skip "twin tests but one in $part" "$((SECONDS / 60)) minutes have passed; cargo nextest run --test twin runs all"
    tests "twin" "${run[@]}" -E 'binary(twin)' --partition "hash:1/$part"
    tests "cargo test doc" cargo test --locked "${features[@]}" --doc
else
    tests "cargo test" cargo test --locked "${features[@]}" --no-fail-fast
fi

# Load and faults for a short while; `make soak` takes longer.
if [ "${POINTILLIST_NATS_SERVER:-}" = required ]; then
    check "soak" scripts/soak.py --program target/debug/pointillist --time 45s --seed "${SOAK_SEED:-1}"
else
    skip "soak" "no nats-server; nothing was killed under load"
fi

# Another Vulkan driver draws the same bytes: the manifest of one may be given, or lie where others are installed.
second_driver() {
    if [ -n "${POINTILLIST_ICD:-}" ]; then
        printf '%s\n' "$POINTILLIST_ICD"
        return
    fi
    local manifest
    for manifest in /opt/mesa*/share/vulkan/icd.d/lvp_icd*.json /usr/local/share/vulkan/icd.d/lvp_icd*.json; do
        if [ -r "$manifest" ]; then
            printf '%s\n' "$manifest"
            return
        fi
    done
}
second=$(second_driver)
if [ -z "$second" ]; then
    skip "second driver" "no other Vulkan driver (POINTILLIST_ICD=MANIFEST); twin and golden tests ran on one"
elif [ ! -r "$second" ]; then
    check "second driver $second" false
else
    on_second=(env VK_DRIVER_FILES="$second" VK_ICD_FILENAMES="$second")
    tests "second driver" "${on_second[@]}" cargo test --locked "${features[@]}" --no-fail-fast --test twin
fi

if command -v shellcheck >/dev/null 2>&1; then
    check "shellcheck" shellcheck .ci/run scripts/*.sh benches/peers/*.sh
else
    # Not a reason to install anything: bash's own parser finds what would keep a script from running.
    syntax() {
        local script
        for script in .ci/run scripts/*.sh benches/peers/*.sh; do bash -n "$script" || return 1; done
    }
    check "shell syntax" syntax
fi

check "deploy files" scripts/lint-deploy.sh target/debug/pointillist

# The contract, in requests that nobody thought of: POINTILLIST_CONTRACT_SECONDS of them.
if [ -n "$python" ]; then
    check "contract" scripts/fuzz-http.sh "$python" --seconds "${POINTILLIST_CONTRACT_SECONDS:-20}"
else
    skip "contract" "no Python tools (scripts/setup-python.sh says why); nothing was sent to a daemon by schemathesis"
fi

echo
if [ "${#failures[@]}" -gt 0 ]; then
    printf 'failed: %s\n' "${failures[@]}"
fi
echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" -eq 0 ] && [ "$passed" -gt 0 ]

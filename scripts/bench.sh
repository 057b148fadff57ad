#!/usr/bin/env bash
# Speed and memory in one run: each bench draws with VTK in turns, on the same files at the same poses, so that
# ratios compare like with like. Tables on standard output; JSON in target/bench/; at the end one table of all targets.
#
#   scripts/bench.sh [BENCH…]      all benches, or the named ones (points statue triangles splats closed equal pull_push painted lines trees lod pops audit daemon stream memory first large planner)
#   BENCH_RECORD=1                 keeps a copy in benches/results/, named after the adapter and the day
#   BENCH_QUICK=1                  smoke check in a minute: tiny files, few repeats, figures without meaning
set -euo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.."
mkdir -p target/bench
if [ "$#" -gt 0 ]; then benches=("$@"); else benches=(points statue triangles splats closed equal pull_push painted lines trees lod pops audit daemon stream memory first large planner); fi

# As in scripts/run.sh: no complaints about a Wayland server that is not there.
export NODEVICE_SELECT=${NODEVICE_SELECT-1}
benches/peers/install.sh || echo "!! SKIPPED: what VTK or trame is needed for and missing; not all could be installed"

# Everything is built before anything is timed.
cargo bench --locked --no-run
run() { cargo bench --quiet --locked --bench "$@"; }
if [ "$#" -eq 0 ]; then
    # What an earlier run left is not this run's result.
    rm -f target/bench/{points,statue,triangles,splats,closed,equal,pull_push,painted,lines,trees,lod,pops,audit,daemon,stream,memory,first,large,planner}.json
fi
failed=()
for bench in "${benches[@]}"; do
    run "$bench" || failed+=("$bench")
done
record=()
if [ -n "${BENCH_RECORD:-}" ] && [ "$BENCH_RECORD" != 0 ]; then record=(-- --record); fi
run summary "${record[@]}"
if [ "${#failed[@]}" -gt 0 ]; then
    echo "bench: failed: ${failed[*]}" >&2
    exit 1
fi

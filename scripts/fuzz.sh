#!/usr/bin/env bash
# Runs the fuzz targets (src/fuzzing) in libFuzzer: TARGETS (default: all), each with FUZZ_RUNS executions (default: 1,000,000), as many at
# a time as there are cores. Prints a line for each target, and fails at the first input that breaks a target, after naming its file.
# Inputs that reach new code stay in target/fuzz/found and begin the next run. FUZZ_MERGE=1 adds the small ones among them to the corpus.
#
#   scripts/fuzz.sh
#   TARGETS="ply scene" FUZZ_RUNS=10000 scripts/fuzz.sh
#   target/fuzz/debug/pointillist-fuzz ply FILE         # one input
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

runs=${FUZZ_RUNS:-1000000}
program=$PWD/target/fuzz/debug/pointillist-fuzz
# Longest input, largest file of the corpus and size of a target's folder there, in bytes.
longest=16384 largest=4096 most=11000

# The words that inputs of a target are made of.
dictionary() { # TARGET
    case $1 in
    query | pose | stream | screening | upload-query | compare | survey | job-order | job-record | farm) echo frame ;;
    scene | path | node-change) echo scene ;;
    ply | ply-blocks) echo ply ;;
    obj | mtl) echo obj ;;
    off | stl) echo off ;;
    vtk | vtp) echo vtk ;;
    gltf | glb) echo gltf ;;
    tck | trk | hair) echo tracks ;;
    *) echo "$1" ;;
    esac
}

# Runs one target: a line of the table on standard output.
run() { # TARGET
    local target=$1 began=$SECONDS found=target/fuzz/found/$1 log=target/fuzz/logs/$1.log options=() status=0 words
    mkdir -p "$found"
    options=(-runs="$runs" -max_len=$longest -timeout=10 -report_slow_units=2 -rss_limit_mb=2048 -malloc_limit_mb=1024
        -artifact_prefix="target/fuzz/crashes/$target-" -print_final_stats=1 -verbosity=1)
    words=tests/fuzz/dictionaries/$(dictionary "$target")
    [ ! -f "$words" ] || options+=("-dict=$words")
    # Without a sanitizer, libFuzzer sees no single large allocation: the limit of the address space refuses it.
    (ulimit -v 8388608 && exec "$program" "$target" "${options[@]}" "$found" "tests/fuzz/corpus/$target") >"$log" 2>&1 || status=$?
    awk -v target="$target" -v seconds="$((SECONDS - began))" '
        /cov: / { for (i = 1; i < NF; i++) if ($i == "cov:") coverage = $(i + 1) }
        /^stat::number_of_executed_units/ { runs = $2 }
        /^stat::new_units_added/ { added = $2 }
        /Test unit written to .*slow-unit/ { slow++ }
        END { printf "%-14s %10d %8d %9d %9d %6d\n", target, runs, seconds, coverage, added, slow }' "$log"
    if [ "$status" -ne 0 ]; then
        grep -hE 'panicked at|ERROR: libFuzzer|Test unit written' -A1 "$log" | tail -8 >&2
        echo "target $target failed; $log tells more" >&2
        exit 255 # xargs starts no other target.
    fi
}

# Adds to a target's corpus what covers code that the corpus does not, the small files first.
merge() { # TARGET
    local corpus=tests/fuzz/corpus/$1 merged file bytes size
    merged=$(mktemp -d)
    "$program" "$1" -merge=1 -max_len=$largest -timeout=10 "$merged" "$corpus" "target/fuzz/found/$1" >"target/fuzz/logs/$1-merge.log" 2>&1
    bytes=$(cat "$corpus"/* | wc -c)
    while read -r size file; do
        if [ "$size" -le $largest ] && [ $((bytes + size)) -le $most ] && ! grep -qxF "$(sha1sum <"$file")" <(sha1sum_all "$corpus"); then
            cp "$file" "$corpus/"
            bytes=$((bytes + size))
        fi
    done < <(find "$merged" -type f -printf '%s %p\n' | sort -n)
    rm -r "$merged"
}

sha1sum_all() { # FOLDER
    local file
    for file in "$1"/*; do sha1sum <"$file"; done
}

if [ "${1:-}" = --one ]; then
    run "$2"
    [ -z "${FUZZ_MERGE:-}" ] || merge "$2"
    exit
fi

# The fuzzer's dependencies are those of the program, and libFuzzer.
cp Cargo.lock tests/fuzz/Cargo.lock
RUSTC_WRAPPER=$PWD/tests/fuzz/rustc.sh cargo build --quiet --manifest-path tests/fuzz/Cargo.toml --target-dir target/fuzz
mkdir -p target/fuzz/{crashes,found,logs}
# Readers of files read each input from a file: in memory, where that is possible.
TMPDIR=$(mktemp -d "$([ -w /dev/shm ] && echo /dev/shm || echo "${TMPDIR:-/tmp}")/fuzz-XXXXXX")
export TMPDIR RAYON_NUM_THREADS=1
trap 'rm -rf "$TMPDIR"' EXIT
targets=${TARGETS:-$("$program" --list)}
printf '%-14s %10s %8s %9s %9s %6s\n' target executions seconds coverage found slow
# shellcheck disable=SC2086 # one word a target
printf '%s\n' $targets | xargs -P "$(nproc)" -n 1 "$0" --one

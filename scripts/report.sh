#!/usr/bin/env bash
# What accuracy costs in time for three scenes, VTK and Open3D at equal picture error, the tables of four papers with ours beside them, the
# promises of frames, and every effect beside the reference, in one report: target/report/index.html, report.md, report.json and headline.svg.
#
#   scripts/report.sh [PART…]      all parts, or the named ones; a wrong name prints their list
#   REPORT_RECORD=1                copies the plot to docs/img/cost.svg, the sheets of effects to docs/img/effects-*.png, and the report to benches/results/, named after the day;
#                                  only where every part was measured to its end
#   REPORT_QUICK=1                 smoke check in two minutes: tiny sizes, figures without meaning, in target/report-quick
#   REPORT_FRESH=1                 measures everything anew
#   REPORT_MINUTES=N               time for all measurements, without building [30]
#
# A part that fails, or that takes longer than its limit, is named in the report, and the others go on. Parts that the time does not suffice for are left
# out. A second run measures only the parts that are missing, unless program or benches have changed since.
set -euo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.."
started=$SECONDS
is_set() { [ -n "${1:-}" ] && [ "$1" != 0 ]; }
all=(town plaza relief equal stability promises checkerboard planner audit splats pull_push painted lod trees effects)
if [ "$#" -gt 0 ]; then parts=("$@"); else parts=("${all[@]}"); fi
for part in "${parts[@]}"; do
    case " ${all[*]} " in *" $part "*) ;; *)
        echo "report: no part is called $part; there are ${all[*]}" >&2
        exit 2
        ;;
    esac
done

# As in scripts/run.sh: no complaints about a Wayland server that is not there.
export NODEVICE_SELECT=${NODEVICE_SELECT-1}
binary=target/release/pointillist
export REPORT_FOLDER=target/report
if is_set "${REPORT_QUICK:-}"; then
    REPORT_FOLDER=target/report-quick
    export BENCH_QUICK=1
    planner_scenes=scenes/relief.json planner_poses=1 planner_budgets=2 audit_poses=1 stability_views=1 promises_extent=--quick
else
    planner_scenes=scenes/town.json,scenes/relief.json planner_poses=20 planner_budgets=40 audit_poses=10 stability_views=32 promises_extent=
fi
folder=$REPORT_FOLDER

# Everything is built before anything is timed.
benches/peers/install.sh || echo "!! SKIPPED: the peers, which could not be installed"
benches=(equal painted splats lod pull_push trees planner audit effects report)
# That builds the program as well, without a second copy of the library.
cargo bench --locked --no-run "${benches[@]/#/--bench=}"

# Measurements of another build, or of another extent, are not continued.
build="$(cksum <"$binary") $(cat benches/*.rs benches/common/*.rs benches/effects/*.rs benches/peers/*.py tests/twin/files.rs scripts/report.sh scenes/*.* scenes/hard/* | cksum)"
if is_set "${REPORT_FRESH:-}" || [ "$build" != "$(cat "$folder/build" 2>/dev/null)" ]; then rm -rf "$folder"; fi
mkdir -p "$folder/benches" "$folder/parts"
echo "$build" >"$folder/build"

# Runs a bench, shortened by its variables, and keeps its results apart from those of `make bench`. A bench that ends with an error after it has
# written them has found a broken promise, which the report prints.
bench() { # NAME
    local status=0
    rm -f "target/bench/$1.json"
    cargo bench --quiet --locked --bench "$1" || status=$?
    if [ -f "target/bench/$1.json" ]; then mv "target/bench/$1.json" "$folder/benches/"; else return "$status"; fi
}

survey() { # NAME SCENE [OPTIONS…]
    local name=$1 scene=$2
    shift 2
    if is_set "${REPORT_QUICK:-}"; then set -- --quick --size 96x54 --repeats 1; fi
    "$binary" accuracy "$scene" -o "$folder/$name" --seed 1 "$@"
}

# Splats of hard cases, and random views of hard scenes. A run that ends with an error after it has written its figures has found a broken bound, which the
# report prints.
stability() {
    local status=0 found=$folder/stability/stability.json
    rm -f "$found"
    "$binary" accuracy --stability --scenes scenes/hard/*.json --views "$stability_views" -o "$folder/stability" || status=$?
    [ -f "$found" ] || return "$status"
}

# Promises without times, checked by a script with the peers' Python, or without them with any.
promises() {
    local python=target/peers/venv/bin/python
    [ -x "$python" ] || python=python3
    "$python" benches/peers/promises.py "$binary" -o "$folder/benches/promises.json" ${promises_extent:+"$promises_extent"}
}

# A ground with a checker, seen at a flat angle, as in Figures 6 and 7 of Zwicker et al. 2004.
checkerboard() {
    "$binary" generate checkerboard --points 60000 --seed 1 -o "$folder/checkerboard.ply"
    cat >"$folder/checkerboard.json" <<'JSON'
{ "assets": { "ground": { "file": "checkerboard.ply" } }, "nodes": [{ "asset": "ground" }], "lights": [],
  "cameras": { "flat": { "eye": [0, 0.35, 5.2], "target": [0, 0, 0], "fov": 40 } } }
JSON
    survey checkerboard "$folder/checkerboard.json" --size 320x180 --repeats 1
}

measure() { # PART
    case $1 in
    town) survey town scenes/town.json --camera overview --size 480x270 ;;
    plaza) survey plaza scenes/plaza.json --camera assembly --size 480x270 ;;
    relief) survey relief scenes/relief.json --camera front --size 480x270 ;;
    checkerboard) checkerboard ;;
    stability) stability ;;
    promises) promises ;;
    equal) bench equal ;;
    painted) bench painted ;;
    splats) BENCH_SPLATS=paper bench splats ;;
    lod) BENCH_LOD="bake cpu distance" bench lod ;;
    pull_push) bench pull_push ;;
    trees) bench trees ;;
    planner) PLANNER_SCENES=$planner_scenes PLANNER_POSES=$planner_poses PLANNER_BUDGETS=$planner_budgets bench planner ;;
    audit) AUDIT_POSES=$audit_poses bench audit ;;
    effects)
        rm -f "$folder"/effects-*.png target/bench/effects/effects-*.png
        bench effects
        cp target/bench/effects/effects-*.png "$folder/"
        ;;
    esac
}
# Seconds that a part may take, several times what it takes on two cores with nothing else to do.
limit_s() {
    case $1 in
    equal) echo 600 ;;
    planner) echo 780 ;;
    audit) echo 480 ;;
    effects) echo 400 ;;
    town | plaza) echo 300 ;;
    *) echo 240 ;;
    esac
}

# A part runs in a process group of its own, so that it can be stopped with all that it started.
set -m
worker='' watch='' reused=''
stop() { # PROCESS_GROUP…
    for group in "$@"; do kill -TERM -- "-$group" 2>/dev/null || true; done
}
trap 'stop $worker $watch; exit 130' INT TERM
began=$SECONDS
for part in "${parts[@]}"; do
    if [ "$(cut -f3 "$folder/parts/$part" 2>/dev/null)" = done ]; then
        echo "report: $part has been measured before"
        reused="$reused $part"
        continue
    fi
    start=$SECONDS status=0 limit=$(limit_s "$part")
    left=$((60 * ${REPORT_MINUTES:-30} - (start - began)))
    if [ "$left" -lt 10 ]; then
        echo "report: no time is left for $part" >&2
        printf '%s\t–\tleft out: no time was left\n' "$part" >"$folder/parts/$part"
        continue
    fi
    if [ "$limit" -gt "$left" ]; then limit=$left; fi
    echo "== $part"
    measure "$part" &
    worker=$!
    (sleep "$limit" && stop "$worker") &
    watch=$!
    wait "$worker" 2>/dev/null || status=$?
    took=$((SECONDS - start))
    stop "$watch"
    wait "$watch" 2>/dev/null || true
    case $status in
    0) state="done" ;;
    143) state="stopped after its limit of $limit s" ;;
    *) state="failed with status $status" ;;
    esac
    printf '%s\t%s\t%s\n' "$part" "$took" "$state" >"$folder/parts/$part"
    [ "$status" -eq 0 ] || echo "!! $part: $state" >&2
done
echo "report: measured for $((SECONDS - began)) s"

scenes=()
for scene in town plaza relief; do
    if [ -f "$folder/$scene/accuracy.json" ]; then scenes+=("$folder/$scene"); fi
done
if [ "${#scenes[@]}" -gt 0 ]; then
    "$binary" accuracy --combine "${scenes[@]}" -o "$folder"
    cp "$folder/cost.svg" "$folder/headline.svg"
fi
for part in "${all[@]}"; do
    cat "$folder/parts/$part" 2>/dev/null || printf '%s\t–\tnot measured\n' "$part"
done >"$folder/parts.tsv"
# Minutes of this run, with building; none where an earlier run measured some of the parts.
rm -f "$folder/minutes"
if [ -z "$reused" ] && [ "${#parts[@]}" = "${#all[@]}" ]; then
    awk -v seconds=$((SECONDS - started)) 'BEGIN { printf "%.1f\n", seconds / 60 }' >"$folder/minutes"
fi
cargo bench --quiet --locked --bench report

failed=()
for part in "${parts[@]}"; do
    if [ "$(cut -f3 "$folder/parts/$part")" != "done" ]; then failed+=("$part"); fi
done
if [ "${#failed[@]}" -gt 0 ]; then
    echo "report: without: ${failed[*]}; the same command measures them again" >&2
    exit 1
fi
if is_set "${REPORT_RECORD:-}"; then
    if is_set "${REPORT_QUICK:-}"; then
        echo "report: a smoke check is not recorded: its figures mean nothing" >&2
        exit 2
    fi
    if [ "$(cut -f3 "$folder/parts.tsv" | sort -u)" != done ]; then
        echo "report: not recorded: some parts were not measured to their end" >&2
        exit 1
    fi
    cp "$folder/headline.svg" docs/img/cost.svg
    cp "$folder"/effects-*.png docs/img/
    cp "$folder/report.md" "benches/results/report-$(date -u +%F).md"
    # The report shows the plot and the sheets beside it.
    sed -i 's|(headline.svg)|(../../docs/img/cost.svg)|; s|(\(effects-[0-9]*.png\))|(../../docs/img/\1)|; /^\[.*index.html)$/d' "benches/results/report-$(date -u +%F).md"
    echo "report: recorded docs/img/cost.svg and benches/results/report-$(date -u +%F).md"
fi
echo "report: $folder/index.html"

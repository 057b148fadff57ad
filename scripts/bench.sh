#!/usr/bin/env bash
# Speed and memory in one run: the project's own benches, then VTK on the same files at the same poses,
# so that ratios compare like with like. Results: target/bench/.
set -euo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=target/bench
mkdir -p "$out"
binary=target/release/pointillist

# The peers' files: points spread in a cube, and a scanned statue, both made by the generators.
[ -s "$out/statue-5m.ply" ] || "$binary" generate statue -o "$out/statue-5m.ply" --points 5000000 --seed 1

cargo bench --locked | tee "$out/cargo-bench.txt"

if benches/peers/install.sh; then
    python=target/peers/venv/bin/python
    : >"$out/vtk.jsonl"
    for mode in points point-gaussian; do
        "$python" benches/peers/vtk_draw.py "$out/statue-5m.ply" --mode "$mode" --size 1024x1024 --jpeg 85 |
            tee -a "$out/vtk.jsonl"
    done
else
    echo "!! SKIPPED: the comparison with VTK, which could not be installed"
fi

#!/usr/bin/env bash
# The demo scenes that are too large to commit, made once by the program's own generators (deterministic:
# the same seed gives the same bytes). An interrupted run leaves no half file behind.
#
#   scripts/demo-scenes.sh [BINARY]
set -euo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.."
binary=${1:-target/release/pointillist}
folder=scenes/generated
mkdir -p "$folder"

# The extension must stay last in the temporary name: it decides the format that is written.
generate() { # FILE KIND [OPTIONS…]
    local file=$folder/$1 kind=$2
    shift 2
    [ -s "$file" ] && return 0
    local partial=$folder/.partial-${file##*/}
    echo "generating $file"
    if ! "$binary" generate "$kind" -o "$partial" "$@"; then
        rm -f "$partial"
        return 1
    fi
    mv "$partial" "$file"
}

generate town-4m.ply town --points 4000000 --seed 1
generate relief-400k.ply relief --triangles 400000 --seed 1

# Scenes go by their files' names, and `town` and `relief` are the small ones beside this folder.
rm -f "$folder/town.json" "$folder/relief.json"
# Scene files name cameras; the town is a survey, so z is up and coordinates are UTM's.
cat >"$folder/town-4m.json" <<'JSON'
{
  "pointillist": 1,
  "name": "Town, 4 M points",
  "up": "z",
  "assets": { "scan": { "file": "town-4m.ply" } },
  "nodes": [ { "name": "scan", "asset": "scan" } ],
  "lights": [],
  "background": "#a9bccb",
  "cameras": {
    "above": { "eye": [412000, 5652840, 230], "target": [412000, 5653000, 110], "fov": 45 },
    "street": { "eye": [411945, 5652930, 122], "target": [412010, 5653010, 114], "fov": 55 }
  }
}
JSON
cat >"$folder/relief-400k.json" <<'JSON'
{
  "pointillist": 1,
  "name": "Relief, 400 K triangles",
  "assets": { "solid": { "file": "relief-400k.ply" } },
  "nodes": [ { "name": "solid", "asset": "solid" } ],
  "lights": [
    { "kind": "ambient", "color": "#ffffff", "intensity": 0.2 },
    { "kind": "sun", "direction": [-1, -1.2, -0.8], "color": "#fff3e0" }
  ]
}
JSON

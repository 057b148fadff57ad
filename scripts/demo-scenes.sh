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
    "overview": { "eye": [411851.713, 5652727.074, 301.338], "target": [411995.45, 5652988.416, 92.265], "fov": 42 },
    "square": { "eye": [411946, 5652924.4, 135.2], "target": [412005.4, 5653009, 120.8], "fov": 50 },
    "above": { "eye": [412001.549, 5652987.569, 368.315], "target": [412001.549, 5652997.439, 131.423], "fov": 50 }
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

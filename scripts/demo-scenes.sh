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

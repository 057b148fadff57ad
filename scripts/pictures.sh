#!/usr/bin/env bash
# Redraws the pictures of README.md, docs/shadows.md and docs/lens.md, docs/img/*.png: those of the shipped scenes, of the dragon where scripts/data.sh brought it, and
# of the viewer where Chromium and chromedriver are installed.
#
#   scripts/pictures.sh [BINARY]
set -euo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.."
binary=${1:-target/release/pointillist}
folder=docs/img
export NODEVICE_SELECT=${NODEVICE_SELECT-1}

draw() { # NAME SCENE [OPTIONS…]
    local name=$1 scene=$2
    shift 2
    "$binary" render "$scene" -o "$folder/$name.png" "$@"
}

# At default settings, so that the README shows what a request gets.
draw town scenes/town.json --camera overview --size 1000x560
draw plaza scenes/plaza.json --camera assembly --size 1000x560
# For docs/shadows.md.
draw night scenes/glasshouse-night.json --camera corner --size 1000x560
# For docs/lens.md.
draw lens scenes/plaza.json --camera walk --aperture 0.25 --focus-distance 8 --size 640x360
if [ -f scenes/data/dragon.json ]; then
    draw dragon scenes/data/dragon.json --size 1000x640
else
    echo "pictures: dragon.png stays as it is; make data fetches the dragon"
fi

driver=$(command -v chromedriver || true)
if [ -z "$driver" ]; then
    echo "pictures: viewer.png stays as it is; it needs chromedriver and Chromium"
    exit 0
fi
log=$(mktemp)
scripts/run.sh "$binary" scenes --listen 127.0.0.1:0 >"$log" 2>/dev/null &
daemon=$!
trap 'kill "$daemon" 2>/dev/null || true; rm -f "$log"' EXIT
until grep -q '^curl ' "$log"; do
    kill -0 "$daemon" || { echo "pictures: the daemon did not start" >&2; exit 1; }
    sleep 0.2
done
url=$(sed -n 's/^viewer: //p' "$log")
python3 scripts/viewer-picture.py "$driver" "$url" "$folder/viewer.png"

#!/usr/bin/env bash
# Starts the server with every scene there is: the committed ones, those that scripts/demo-scenes.sh made
# and those that scripts/data.sh brought. Arguments are passed on to `pointillist serve`.
#
#   scripts/run.sh BINARY ROOT [OPTIONS…]
set -euo pipefail

binary=$1 root=$2
shift 2
# The scene that is loaded first: the viewer opens with it, and the command that the server prints fetches it.
first=town
scenes=()
[ -f "$root/$first.json" ] && scenes+=(--scene "$first.json")
for file in "$root"/*.json "$root"/generated/*.json "$root"/data/*.json; do
    [ "$file" = "$root/$first.json" ] && continue
    [ -f "$file" ] && scenes+=(--scene "${file#"$root"/}")
done
# Mesa's device-select layer asks a Wayland server which GPU the desktop prefers, and writes an error where there is
# none. The program chooses its adapter itself (POINTILLIST_ADAPTER), so the layer stays out.
export NODEVICE_SELECT=${NODEVICE_SELECT-1}
exec "$binary" serve --root "$root" "${scenes[@]}" "$@"

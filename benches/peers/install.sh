#!/usr/bin/env bash
# Installs the peers that `make bench` compares with into a virtual environment of their own
# (target/peers/venv, or the folder given as the first argument). Nothing outside it is touched.
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
venv=${1:-$here/target/peers/venv}

# All that the scripts import: an environment of an earlier time may have VTK and no trame.
imports='import aiohttp, laspy, nibabel, numpy, PIL, vtk, trame.app, trame.widgets.vtk, trame_server.client'
lib=$venv/lib/system
# Open3D links to a library for depth cameras that machines without a desktop lack. It is unpacked beside Open3D, so that nothing outside the folder
# changes; the scripts are run with this folder on LD_LIBRARY_PATH.
open3d() {
    local python=$venv/bin/python
    has() { LD_LIBRARY_PATH=$lib "$python" -c 'import open3d' 2>/dev/null; }
    has && return
    "$venv/bin/pip" install --quiet --disable-pip-version-check 'open3d-cpu>=0.19' || return 1
    has && return
    local unpacked
    unpacked=$(mktemp -d)
    (cd "$unpacked" && apt-get download libusb-1.0-0 >/dev/null 2>&1 && dpkg -x libusb-1.0-0_*.deb .) || true
    mkdir -p "$lib"
    find "$unpacked" -name 'libusb-1.0.so.*' -exec cp -d {} "$lib" \;
    rm -rf "$unpacked"
    has
}
add_open3d() {
    if open3d; then
        echo "peers: open3d $("$venv/bin/pip" show open3d-cpu | sed -n 's/^Version: //p')"
    else
        echo "peers: no Open3D: open3d-cpu from PyPI cannot be installed or loaded here (Debian: libusb-1.0-0)" >&2
    fi
}

# FLIP as its authors publish it. Where PyPI has no build of it, a C++ compiler is needed.
add_flip() {
    if "$venv/bin/python" -c 'import flip_evaluator' 2>/dev/null ||
        "$venv/bin/pip" install --quiet --disable-pip-version-check 'flip-evaluator>=1.7'; then
        echo "peers: flip-evaluator $("$venv/bin/pip" show flip-evaluator | sed -n 's/^Version: //p')"
    else
        echo "peers: no flip-evaluator: it cannot be installed from PyPI here" >&2
    fi
}

if [ -x "$venv/bin/python" ] && "$venv/bin/python" -c "$imports" 2>/dev/null; then
    echo "peers: already installed in $venv"
    add_open3d
    add_flip
    exit 0
fi

python=
for candidate in python3 python; do
    if command -v "$candidate" >/dev/null 2>&1 && "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 9))'; then
        python=$candidate
        break
    fi
done
if [ -z "$python" ]; then
    echo "peers: Python 3.9 or newer is needed (Debian: apt-get install python3 python3-venv)" >&2
    exit 1
fi

mkdir -p "$(dirname "$venv")"
if ! "$python" -m venv "$venv"; then
    echo "peers: $python cannot make virtual environments (Debian: apt-get install python3-venv)" >&2
    exit 1
fi
# VTK from 9.4 on chooses an off-screen window (EGL, else OSMesa) by itself when there is no X server.
# trame brings wslink; aiohttp is what both ends of its WebSocket are made with, pillow decodes what its client gets.
"$venv/bin/pip" install --quiet --disable-pip-version-check 'numpy>=1.26' 'vtk>=9.4' \
    'trame>=3.6' 'trame-vtk>=2.8' aiohttp laspy nibabel pillow
"$venv/bin/python" - <<'PY'
from importlib.metadata import version
print("peers: " + ", ".join(f"{name} {version(name)}" for name in ("vtk", "numpy", "trame", "trame-vtk", "laspy", "nibabel")))
PY
add_open3d
add_flip

#!/usr/bin/env bash
# Puts the Python tools that the tests run (tests/contract/requirements.txt) into a virtual environment below target/, and prints
# its folder as the last line. Exit status 1, with the reason, when there is no way: those tests then count as skipped, loudly.
#
#   scripts/setup-python.sh          find Python, make the environment, install what is missing
#   scripts/setup-python.sh --lock   write requirements.txt anew from requirements.in, with hashes
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

here=tests/contract
wanted=$here/requirements.txt
folder=$PWD/target/python
say() { printf 'setup-python: %s\n' "$*" >&2; }
fail() {
    printf 'setup-python: %s\n' "$@" >&2
    exit 1
}

# The tools need this version at least.
works() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }
find_python() {
    local name
    for name in ${PYTHON:-} python3 python3.14 python3.13 python3.12 python3.11; do
        if command -v "$name" >/dev/null 2>&1 && works "$name"; then
            command -v "$name"
            return 0
        fi
    done
    return 1
}

apt_install() {
    command -v apt-get >/dev/null 2>&1 || return 1
    local as_root=()
    if [ "$(id -u)" -ne 0 ]; then
        # -n: a test run must not stop to ask for a password.
        sudo -n true 2>/dev/null || return 1
        as_root=(sudo -n)
    fi
    say "installing $* with apt-get"
    local install=("${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "$@")
    "${install[@]}" >/dev/null 2>&1 </dev/null && return 0
    "${as_root[@]}" apt-get update >/dev/null 2>&1 </dev/null || true
    "${install[@]}" >/dev/null 2>&1 </dev/null
}

python=$(find_python) || {
    apt_install python3 python3-venv || fail "no Python 3.11 or newer here, and apt-get cannot install one"
    python=$(find_python) || fail "no Python 3.11 or newer, even after installing python3"
}

if [ "${1:-}" = --lock ]; then
    "$python" -m venv "$folder-lock" || fail "python3-venv is needed to lock"
    "$folder-lock/bin/python" -m pip install --quiet pip-tools
    "$folder-lock/bin/pip-compile" --quiet --generate-hashes --strip-extras --no-emit-options \
        --output-file "$wanted" "$here/requirements.in"
    rm -rf "$folder-lock"
    say "$wanted is written"
    exit 0
fi

# What is installed, by the list that it was installed from and the Python that it is for.
stamp=$({ cat "$wanted" && "$python" -V; } | sha256sum | cut -d ' ' -f 1)
if [ -x "$folder/bin/schemathesis" ] && [ "$(cat "$folder/stamp" 2>/dev/null)" = "$stamp" ]; then
    echo "$folder"
    exit 0
fi

rm -rf "$folder"
mkdir -p "$(dirname "$folder")"
make_environment() {
    "$python" -m venv "$folder" >/dev/null 2>&1 && "$folder/bin/python" -m pip --version >/dev/null 2>&1
}
# Debian splits off what makes environments. Where it cannot be installed, pip may be there all the same.
if ! make_environment; then
    rm -rf "$folder"
    if apt_install python3-venv && make_environment; then
        :
    elif rm -rf "$folder" && "$python" -m venv --without-pip "$folder" && "$python" -m pip --version >/dev/null 2>&1; then
        say "without ensurepip: installing with the pip of $python"
    else
        fail "no virtual environment can be made: Debian's package is python3-venv"
    fi
fi
pip=("$folder/bin/python" -m pip)
"${pip[@]}" --version >/dev/null 2>&1 || pip=("$python" -m pip --python "$folder/bin/python")

say "installing $(grep -c '^[a-z].*==' "$wanted") Python packages into ${folder#"$PWD"/}"
log=$folder/install.log
if ! "${pip[@]}" install --quiet --disable-pip-version-check --no-input --require-hashes -r "$wanted" >"$log" 2>&1; then
    tail -n 5 "$log" >&2
    rm -rf "$folder"
    fail "pip could not install $wanted: is a Python package index reachable?"
fi
[ -x "$folder/bin/schemathesis" ] || fail "schemathesis is missing after the install"
echo "$stamp" >"$folder/stamp"
echo "$folder"

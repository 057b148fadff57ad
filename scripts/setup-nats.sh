#!/usr/bin/env bash
# Finds nats-server for the tests of workers, or installs Debian's package; without root, below target/nats. Exit status 1, with
# the reason, when there is no way: the tests then skip themselves loudly.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

own=target/nats
have_nats() {
    command -v nats-server >/dev/null 2>&1 || [ -x /usr/sbin/nats-server ] || [ -x "$own/usr/sbin/nats-server" ]
}
fail() {
    printf 'setup-nats: %s\n' "$@" >&2
    exit 1
}

if have_nats; then
    echo "setup-nats: nats-server is here"
    exit 0
fi
command -v apt-get >/dev/null 2>&1 || fail "no nats-server here and no apt-get to install one"

apt_install() {
    local as_root=()
    if [ "$(id -u)" -ne 0 ]; then
        # -n: a test run must not stop to ask for a password.
        command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null || return 1
        as_root=(sudo -n)
    fi
    local install=("${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends nats-server)
    "${install[@]}" </dev/null >/dev/null 2>&1 && return 0
    "${as_root[@]}" apt-get update </dev/null >/dev/null 2>&1 || true
    "${install[@]}" </dev/null >/dev/null 2>&1
}
unpack() {
    local folder
    folder=$(mktemp -d)
    (cd "$folder" && apt-get download nats-server >/dev/null 2>&1) || return 1
    mkdir -p "$own"
    dpkg -x "$folder"/nats-server_*.deb "$own"
    rm -rf "$folder"
}
echo "setup-nats: installing nats-server"
apt_install || unpack || fail "apt-get could neither install nor download nats-server"
have_nats || fail "nats-server is still missing after the install"

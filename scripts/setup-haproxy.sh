#!/usr/bin/env bash
# Finds HAProxy for the test of deploy/haproxy.cfg, or installs Debian's package. Exit status 1, with the reason, when
# there is no way: the test then skips itself loudly.
set -euo pipefail

have_haproxy() { command -v haproxy >/dev/null 2>&1 || [ -x /usr/sbin/haproxy ]; }
fail() {
    printf 'setup-haproxy: %s\n' "$@" >&2
    exit 1
}

if have_haproxy; then
    echo "setup-haproxy: haproxy is here"
    exit 0
fi
command -v apt-get >/dev/null 2>&1 || fail "no haproxy here and no apt-get to install one"
as_root=()
if [ "$(id -u)" -ne 0 ]; then
    # -n: a test run must not stop to ask for a password.
    if ! command -v sudo >/dev/null 2>&1 || ! sudo -n true 2>/dev/null; then
        fail "installing haproxy needs root"
    fi
    as_root=(sudo -n)
fi
apt_install() {
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends haproxy </dev/null
}
echo "setup-haproxy: installing haproxy with apt-get"
if ! apt_install >/dev/null 2>&1; then
    "${as_root[@]}" apt-get update </dev/null >/dev/null 2>&1 || true
    apt_install >/dev/null || fail "apt-get could not install haproxy"
fi
have_haproxy || fail "haproxy is still missing after the install"

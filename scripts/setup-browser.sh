#!/usr/bin/env bash
# Finds Chromium and its WebDriver for the browser test, or installs Debian's packages. Exit status 1,
# with the reason, when there is no way: the test then skips itself loudly.
set -euo pipefail

have() { command -v "$1" >/dev/null 2>&1; }
have_browser() {
    [ -n "${CHROMEDRIVER:-}" ] && [ -x "${CHROMEDRIVER}" ] && return 0
    have chromedriver && { have chromium || have chromium-browser || have google-chrome; }
}
fail() {
    printf 'setup-browser: %s\n' "$@" >&2
    exit 1
}

if have_browser; then
    echo "setup-browser: chromedriver and a browser are here"
    exit 0
fi
have apt-get || fail "no chromedriver here and no apt-get to install one"
as_root=()
if [ "$(id -u)" -ne 0 ]; then
    # -n: a test run must not stop to ask for a password.
    if ! have sudo || ! sudo -n true 2>/dev/null; then
        fail "installing chromium and chromium-driver needs root"
    fi
    as_root=(sudo -n)
fi
apt_install() {
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
        chromium chromium-driver </dev/null
}
echo "setup-browser: installing chromium and chromium-driver with apt-get"
if ! apt_install >/dev/null 2>&1; then
    "${as_root[@]}" apt-get update </dev/null >/dev/null 2>&1 || true
    apt_install >/dev/null || fail "apt-get could not install chromium and chromium-driver"
fi
have_browser || fail "chromedriver is still missing after the install"

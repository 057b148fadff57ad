#!/usr/bin/env bash
# Finds HAProxy, nginx and Prometheus for the tests of deploy/. Missing ones are unpacked from Debian's packages into
# target/servers, which needs no root and changes nothing else. Prints the folder of the unpacked programs, to be put in front of
# PATH. Exit status 1, with the reason, when a program is missing: its tests then skip themselves loudly.
#
#   scripts/setup-servers.sh [PROGRAM…]      default: haproxy nginx prometheus promtool
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

folder=$PWD/target/servers
root=$folder/root
programs=("$@")
[ "${#programs[@]}" -gt 0 ] || programs=(haproxy nginx prometheus promtool)
fail() {
    printf 'setup-servers: %s\n' "$@" >&2
    exit 1
}

# Servers lie in sbin, which a user's PATH may lack.
find_program() { PATH=$folder/bin:$PATH:/usr/local/sbin:/usr/sbin:/sbin command -v "$1"; }
works() {
    local program
    program=$(find_program "$1") || return 1
    case $1 in
    prometheus | promtool) "$program" --version >/dev/null 2>&1 ;;
    *) "$program" -v >/dev/null 2>&1 ;;
    esac
}

package_of() { # PROGRAM → Debian's package
    case $1 in
    prometheus | promtool) echo prometheus ;;
    *) echo "$1" ;;
    esac
}

installed() { [ "$(dpkg-query -W -f='${db:Status-Status}' "$1" 2>/dev/null)" = installed ]; }

# Options of apt: the system's lists of packages, or lists of our own where it has none.
apt=()
own_lists() {
    mkdir -p "$folder/apt/lists/partial" "$folder/apt/archives/partial"
    apt=(-o "Dir::State::Lists=$folder/apt/lists" -o "Dir::Cache=$folder/apt" -o APT::Sandbox::User=)
    apt-get "${apt[@]}" update >"$folder/apt/log" 2>&1 || fail "apt-get update failed: $(tail -n 1 "$folder/apt/log")"
}

# The shared libraries that a package needs and this machine lacks.
libraries_of() { # PACKAGE
    local library
    for library in $(apt-cache "${apt[@]}" depends "$1" 2>/dev/null | sed -nE 's/^ *\|?Depends: (lib[^ ]+)$/\1/p' | grep -v '^libjs-'); do
        installed "$library" && continue
        echo "$library"
        libraries_of "$library"
    done
}

unpack() { # PACKAGE…
    local package packages=()
    for package in "$@"; do
        # Not a process substitution: its failure would go unnoticed.
        read -ra libraries <<<"$(libraries_of "$package" | sort -u | tr '\n' ' ')"
        packages+=("$package" "${libraries[@]}")
    done
    mkdir -p "$folder/debs" "$root"
    (cd "$folder/debs" && apt-get "${apt[@]}" -o APT::Sandbox::User= download "${packages[@]}") >"$folder/log" 2>&1 || return 1
    for package in "$folder"/debs/*.deb; do dpkg -x "$package" "$root"; done
    rm -rf "$folder/debs"
}

wrap() { # PROGRAM: a script that finds the unpacked libraries
    local file libraries
    for file in "$root/usr/sbin/$1" "$root/usr/bin/$1"; do
        [ -x "$file" ] || continue
        libraries=$(printf %s "$root"/usr/lib/*-linux-gnu)
        mkdir -p "$folder/bin"
        # exec: signals reach the program itself.
        printf '#!/bin/sh\nLD_LIBRARY_PATH=%q${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH} exec %q "$@"\n' "$libraries" "$file" >"$folder/bin/$1"
        chmod +x "$folder/bin/$1"
        return 0
    done
    return 1
}

missing=()
for program in "${programs[@]}"; do works "$program" || missing+=("$program"); done
if [ "${#missing[@]}" -gt 0 ]; then
    for tool in apt-get apt-cache dpkg; do
        command -v "$tool" >/dev/null 2>&1 || fail "no ${missing[*]} here, and no $tool to unpack Debian's packages"
    done
    read -ra packages <<<"$(for program in "${missing[@]}"; do package_of "$program"; done | sort -u | tr '\n' ' ')"
    echo "setup-servers: unpacking ${packages[*]} into ${folder#"$PWD"/}" >&2
    mkdir -p "$folder"
    if ! unpack "${packages[@]}"; then
        own_lists
        unpack "${packages[@]}" || fail "apt-get cannot download ${packages[*]}: $(tail -n 1 "$folder/log")"
    fi
    for program in "${missing[@]}"; do
        wrap "$program" || fail "$program is not in Debian's package $(package_of "$program")"
        works "$program" || fail "$program does not run after unpacking: $("$folder/bin/$program" --version 2>&1 | tail -n 1)"
    done
fi
echo "$folder/bin"

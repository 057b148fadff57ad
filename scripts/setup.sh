#!/usr/bin/env bash
# Makes this machine able to build and run: a Rust toolchain (checked), a C linker and a Vulkan driver
# (found, or installed with apt where there is one). Changes nothing when all is there.
#
#   scripts/setup.sh            check, install what is missing
#   scripts/setup.sh --check    check only; exit 1 and a list when something is missing
set -euo pipefail

check_only=false
case ${1:-} in
'') ;;
--check) check_only=true ;;
*)
    echo "usage: scripts/setup.sh [--check]" >&2
    exit 2
    ;;
esac

say() { printf 'setup: %s\n' "$*"; }
fail() {
    printf 'setup: %s\n' "$@" >&2
    exit 1
}

# Cargo lives here after a rustup install whose shell has not been reopened yet.
export PATH="$PATH:${CARGO_HOME:-$HOME/.cargo}/bin"

have_cargo() { command -v cargo >/dev/null 2>&1; }
have_linker() { command -v cc >/dev/null 2>&1; }

# The folders that the Vulkan loader reads driver manifests from.
icd_folders() {
    local IFS=:
    # shellcheck disable=SC2086  # splitting at colons is meant
    printf '%s\n' ${XDG_CONFIG_HOME:-$HOME/.config} ${XDG_CONFIG_DIRS:-/etc/xdg} /etc \
        ${XDG_DATA_HOME:-$HOME/.local/share} ${XDG_DATA_DIRS:-/usr/local/share:/usr/share} |
        sed 's|$|/vulkan/icd.d|'
}

have_library() { # a shared library's file name, as the dynamic linker would find it
    local ldconfig
    for ldconfig in ldconfig /sbin/ldconfig /usr/sbin/ldconfig; do
        if command -v "$ldconfig" >/dev/null 2>&1; then
            # Not grep -q: it closes the pipe early, which pipefail would take for a failure.
            "$ldconfig" -p 2>/dev/null | grep -F "$1 " >/dev/null && return 0
            break
        fi
    done
    local folder
    for folder in ${LD_LIBRARY_PATH:+${LD_LIBRARY_PATH//:/ }} /usr/lib /usr/lib64 /lib /usr/lib/*-linux-gnu /usr/local/lib; do
        [ -e "$folder/$1" ] && return 0
    done
    return 1
}

have_gpu_device() {
    local node
    for node in /dev/dri/renderD* /dev/nvidiactl /dev/dxg; do
        [ -e "$node" ] && return 0
    done
    return 1
}

# A manifest counts when the library it names exists (packages get removed and leave links behind) and
# when it can have a device: lavapipe always, the others where the kernel shows a GPU.
have_icd() {
    local manifests=() folder file library
    if [ -n "${VK_DRIVER_FILES:-${VK_ICD_FILENAMES:-}}" ]; then
        IFS=: read -ra manifests <<<"${VK_DRIVER_FILES:-$VK_ICD_FILENAMES}"
    else
        while IFS= read -r folder; do
            for file in "$folder"/*.json; do
                [ -r "$file" ] && manifests+=("$file")
            done
        done < <(icd_folders)
    fi
    for file in "${manifests[@]}"; do
        [ -r "$file" ] || continue
        case ${file##*/} in
        lvp_icd* | *swrast* | *swiftshader*) ;;
        *) have_gpu_device || continue ;;
        esac
        library=$(sed -n 's/.*"library_path"[[:space:]]*:[[:space:]]*"\([^"]*\)".*/\1/p' "$file" | head -n 1)
        case $library in
        '') ;;
        /*) [ -e "$library" ] && return 0 ;;
        */*) [ -e "$(dirname "$file")/$library" ] && return 0 ;;
        *) have_library "$library" && return 0 ;;
        esac
    done
    return 1
}

have_vulkan() {
    case $(uname -s) in
    Darwin) return 0 ;; # Metal is part of the system
    esac
    have_library libvulkan.so.1 && have_icd
}

missing_packages() { # Debian's names
    have_linker || echo gcc libc6-dev
    have_vulkan || echo libvulkan1 mesa-vulkan-drivers
}

# --- Rust ---------------------------------------------------------------------------------------
if ! have_cargo; then
    fail "cargo was not found; Rust ${RUST_VERSION:-1.90 or newer} is needed." \
        "Install it from https://rustup.rs (or your distribution), then run this again."
fi

# --- linker and driver --------------------------------------------------------------------------
read -ra packages <<<"$(missing_packages | tr '\n' ' ')"
if [ "${#packages[@]}" -eq 0 ]; then
    say "cargo, a linker and a Vulkan driver are here"
    exit 0
fi
if [ "$check_only" = true ]; then
    fail "missing (Debian's package names): ${packages[*]}"
fi

if [ "$(uname -s)" = Darwin ]; then
    fail "no C linker: run 'xcode-select --install', then this again."
fi
if ! command -v apt-get >/dev/null 2>&1; then
    if command -v dnf >/dev/null 2>&1; then
        hint="sudo dnf install gcc vulkan-loader mesa-vulkan-drivers"
    elif command -v pacman >/dev/null 2>&1; then
        hint="sudo pacman -S --needed gcc vulkan-icd-loader vulkan-swrast"
    elif command -v zypper >/dev/null 2>&1; then
        hint="sudo zypper install gcc libvulkan1 libvulkan_lvp"
    elif command -v apk >/dev/null 2>&1; then
        hint="sudo apk add build-base vulkan-loader mesa-vulkan-swrast"
    else
        hint="a C compiler (cc), the Vulkan loader (libvulkan.so.1) and a driver, such as Mesa's lavapipe"
    fi
    fail "missing (Debian's package names): ${packages[*]}" \
        "This system has no apt-get, so nothing was installed. What should do it:" "  $hint"
fi

as_root=()
if [ "$(id -u)" -ne 0 ]; then
    if ! command -v sudo >/dev/null 2>&1; then
        fail "missing: ${packages[*]}" \
            "Installing them needs root and there is no sudo here. As root, run:" \
            "  apt-get update && apt-get install --no-install-recommends ${packages[*]}"
    fi
    as_root=(sudo)
fi

say "installing ${packages[*]} with apt-get"
apt_install() {
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "${packages[@]}" </dev/null
}
# The lists may be absent or stale; refreshing first would make every run depend on the network.
if ! apt_install; then
    "${as_root[@]}" apt-get update </dev/null
    apt_install || fail "apt-get could not install ${packages[*]}"
fi

have_linker || fail "a C linker (cc) is still missing after installing gcc"
have_vulkan || fail "no Vulkan driver is found even after installing ${packages[*]};" \
    "looked for libvulkan.so.1 and for manifests in:" "$(icd_folders | tr '\n' ' ')"
say "ready"

#!/bin/sh
# Prepares this machine to build and run stein, its viewer and their tests. Installs what is missing:
#   - a C linker, a C++ compiler (the FLIP error measure is C++), Rust;
#   - the X libraries of the viewer's window, and the virtual screen of its test;
#   - Mesa's drivers with a software adapter (lavapipe), if no Vulkan adapter is found.
# Prints nothing if nothing is missing. Needs apt-get (Debian, Ubuntu), and root or sudo, only to install.
set -eu

say() {
    printf 'setup: %s\n' "$*" >&2
}

has_library() {
    { ldconfig -p || /sbin/ldconfig -p; } 2>/dev/null | grep -qF "$1" && return 0
    for folder in /usr/lib /usr/lib/* /usr/lib64 /usr/local/lib /lib/*; do
        [ -e "$folder/$1" ] && return 0
    done
    return 1
}

# A driver announces itself by a JSON file: in one of the loader's folders, or named by an environment variable, which
# then replaces the folders.
has_driver() {
    named="${VK_DRIVER_FILES:-${VK_ICD_FILENAMES:-}}"
    if [ -n "$named" ]; then
        old_ifs=$IFS
        IFS=:
        for place in $named; do
            IFS=$old_ifs
            if is_driver "$place" || any_driver_in "$place"; then
                return 0
            fi
        done
        IFS=$old_ifs
        return 1
    fi
    for folder in "${XDG_CONFIG_HOME:-${HOME:-/root}/.config}" /etc/xdg /etc \
        "${XDG_DATA_HOME:-${HOME:-/root}/.local/share}" /usr/local/share /usr/share; do
        any_driver_in "$folder/vulkan/icd.d" && return 0
    done
    return 1
}

any_driver_in() {
    for file in "$1"/*.json; do
        is_driver "$file" && return 0
    done
    return 1
}

is_driver() {
    [ -f "$1" ] && grep -q '"library_path"' "$1"
}

# The file may exist without the hardware: if vulkaninfo is installed, ask it whether the driver finds an adapter.
has_adapter() {
    has_library libvulkan.so.1 && has_driver || return 1
    command -v vulkaninfo >/dev/null 2>&1 || return 0
    vulkaninfo --summary </dev/null 2>/dev/null | grep -q 'deviceName'
}

as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        "$@"
    elif command -v sudo >/dev/null 2>&1; then
        # -n: fails instead of asking for a password that nobody can type.
        if [ -t 0 ]; then sudo "$@"; else sudo -n "$@"; fi
    else
        say "cannot install packages: run this script as root, or install sudo"
        exit 1
    fi
}

apt_install() {
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" </dev/null >/dev/null
}

# The package lists may be absent (containers) or old. Fetching them takes long, so it is done only if installing fails.
install_packages() {
    if ! command -v apt-get >/dev/null 2>&1; then
        say "apt-get is missing: install the equivalents of these Debian packages with this system's package manager:" \
            "$*"
        exit 1
    fi
    if ! apt_install "$@" 2>/dev/null; then
        as_root env DEBIAN_FRONTEND=noninteractive apt-get update -qq </dev/null >/dev/null
        apt_install "$@"
    fi
}

if ! command -v cargo >/dev/null 2>&1 && ! [ -x "${CARGO_HOME:-$HOME/.cargo}/bin/cargo" ]; then
    say "no Rust found: installing it with rustup"
    command -v curl >/dev/null 2>&1 || install_packages curl ca-certificates
    curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs | sh -s -- -y --profile minimal >&2
fi

[ "$(uname -s)" = Linux ] || exit 0
if ! command -v cc >/dev/null 2>&1; then
    say "no C linker found: installing gcc"
    install_packages gcc libc6-dev
fi
if ! command -v c++ >/dev/null 2>&1; then
    say "no C++ compiler found: installing g++"
    install_packages g++
fi

# Libraries that the viewer's window loads when it opens, and their packages.
window=
while read -r library package; do
    has_library "$library" || window="$window $package"
done <<END
libX11.so.6 libx11-6
libX11-xcb.so.1 libx11-xcb1
libXcursor.so.1 libxcursor1
libXi.so.6 libxi6
libxkbcommon.so.0 libxkbcommon0
libxkbcommon-x11.so.0 libxkbcommon-x11-0
END
command -v Xvfb >/dev/null 2>&1 || window="$window xvfb"
if [ -n "$window" ]; then
    say "the viewer's window or its test lacks something: installing$window"
    # Everything else works without them.
    # shellcheck disable=SC2086
    (install_packages $window) || say "not installed: the viewer may not open its window, and the test of that fails"
fi

has_adapter && exit 0
say "no Vulkan adapter found: installing a software one (libvulkan1, mesa-vulkan-drivers)"
install_packages libvulkan1 mesa-vulkan-drivers
if has_adapter; then
    say "done"
else
    say "the packages are installed, but no Vulkan adapter is found;" \
        "VK_DRIVER_FILES and VK_ICD_FILENAMES may point elsewhere"
    exit 1
fi

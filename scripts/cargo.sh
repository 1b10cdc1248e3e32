#!/bin/sh
# Runs cargo with these arguments, after installing what this machine lacks.
set -eu
"$(dirname "$0")/setup.sh"
# Mesa has a layer that puts the desktop's adapter first. Without a desktop it only prints warnings.
[ -n "${XDG_RUNTIME_DIR:-}" ] || export NODEVICE_SELECT=1
# setup.sh may have just installed Rust, in a folder that is not in PATH yet.
PATH="${CARGO_HOME:-$HOME/.cargo}/bin:$PATH" exec cargo "$@"

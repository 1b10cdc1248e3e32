#!/bin/sh
# Runs cargo with these arguments, after installing what this machine lacks.
set -eu
"$(dirname "$0")/setup.sh"
# Mesa has a layer that puts the desktop's adapter first; where there is no desktop, all it does is complain.
[ -n "${XDG_RUNTIME_DIR:-}" ] || export NODEVICE_SELECT=1
# Where setup.sh has just installed Rust, this shell does not know yet.
PATH="${CARGO_HOME:-$HOME/.cargo}/bin:$PATH" exec cargo "$@"

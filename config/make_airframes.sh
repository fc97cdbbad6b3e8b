#!/usr/bin/env bash
# Make the airframe files of this folder anew, from simulated flights of the scenarios' aircraft in different winds.
# Needs `make train-setup`. Usage: config/make_airframes.sh [FOLDER for the bags, kept]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
folder=${1:-$(mktemp -d)}
run() { NAV_POSE_VENV=.venv-train tools/in_environment.sh python -m nav_pose_estimator "$@"; }

make_airframe() { # NAME SCENARIO CLASS
    local seed bags=()
    for seed in 11 12 13 14 15 16; do
        bags+=("$folder/$1_$seed")
        [ -e "$folder/$1_$seed" ] || run simulate "$folder/$1_$seed" --scenario "$2" --duration 300 --seed "$seed"
    done
    run train "${bags[@]}" --out "config/$1.airframe" --class "$3" --one-aircraft --gnss-delay 0 \
        --network --steps 800 --folds 2 --force
}

make_airframe sim_wing fixed_wing fixed_wing
make_airframe sim_multirotor multirotor_moderate multirotor

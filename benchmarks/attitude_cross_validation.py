"""Cross-validation of the attitude filters: parameters are selected without the family of trials they are tested on.

    python benchmarks/attitude_cross_validation.py TRIAL.npz...

Protocol:
1. The trials (BROAD) fall into families by what was done: slow rotation, fast rotation, attached magnet... A trial with
   breaks belongs to the family of its motion. Members of a family resemble each other; members of two do not.
2. For each family in turn, every candidate of the grid below runs on all other families, and the one with the smallest
   mean of inclination (without magnetometer) and total error (with it) is chosen. Then it runs on the family left out.
3. Reported is the mean over all trials of the figures of step 2 ("left out"), and of the candidate that is best on all
   trials ("in sample"). Their difference is the benefit of selecting on these trials.
4. Cold starts are run with the selected candidates, but not used in the selection.

The parameters of the grid are those that these motions are sensitive to. The structure of the filter was also designed
with these trials, which no cross-validation can compensate; see docs/attitude.md.
"""

import argparse
import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.offline.benchmarks.attitude.benchmark import METHODS, judge
from nav_pose_estimator.offline.benchmarks.attitude.trials import CONDITIONS, Trial, load_trial

GRIDS = {
    "complementary": {
        "attitude.turn_noise": (0.0004, 0.0007, 0.0012),
        "attitude.heading_noise": (0.1, 0.14, 0.2),
        "attitude.anomaly_gain": (20.0, 60.0, 120.0),
    },
    "two_stage": {
        "attitude.two_stage.wander": (0.005, 0.009, 0.015),
        "attitude.two_stage.heading_noise": (0.1, 0.15, 0.25),
    },
}
Candidate = tuple[float, ...]


def family(name: str) -> str:
    """Family of the trial ``name``: the name without number, letter or distance, and breaks."""
    what = re.sub(r"^\d+_(un)?disturbed_", "", name).replace("_with_breaks", "")
    return re.sub(r"_([A-Z]|\d+cm)$", "", what)


def candidates(method: str) -> Iterator[Candidate]:
    """All combinations of the grid."""
    return itertools.product(*GRIDS[method].values())


def score(trial: Trial, method: str, candidate: Candidate, condition: str = "recorded") -> np.ndarray:
    """Inclination without, heading and total with magnetometer (3,) [deg]."""
    parameters = update(Parameters(), dict(zip(GRIDS[method], candidate, strict=True)))
    (row,) = judge(CONDITIONS[condition](trial), condition, [method], parameters=parameters)
    return np.array([row.inclination_deg, row.heading_deg, row.total_deg])


def cross_validate(trials: list[Trial], method: str) -> None:
    """Print the table of one filter."""
    families = np.array([family(trial.name) for trial in trials])
    scores = {c: np.array([score(trial, method, c) for trial in trials]) for c in candidates(method)}

    def best(use: np.ndarray) -> Candidate:
        return min(scores, key=lambda c: float(np.mean(scores[c][use][:, [0, 2]])))

    print(f"\n{method}: candidates over {', '.join(GRIDS[method])}; deg: inclination, heading, total")
    left_out, cold = np.empty((len(trials), 3)), np.empty((len(trials), 3))
    for name in dict.fromkeys(families):
        out = families == name
        chosen = best(~out)
        left_out[out] = scores[chosen][out]
        cold[out] = [score(trials[i], method, chosen, "cold_start") for i in np.flatnonzero(out)]
        print(f"{name:20s} {out.sum():2d} trials  {_text(left_out[out])}   chosen without it: {chosen}")
    in_sample = best(np.full(len(trials), True))
    print(f"{'in sample':20s} {len(trials):2d} trials  {_text(scores[in_sample])}   {in_sample}")
    print(f"{'left out':20s} {len(trials):2d} trials  {_text(left_out)}")
    print(f"{'left out, cold start':20s} {len(trials):2d} trials  {_text(cold)}", flush=True)


def _text(rows: np.ndarray) -> str:
    return "  ".join(f"{value:5.2f}" for value in rows.mean(axis=0))


def main() -> None:
    """Print the protocol and a table for each filter."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trials", nargs="+", type=Path, metavar="TRIAL.npz")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    arguments = parser.parse_args()
    print(__doc__)
    trials = [load_trial(path) for path in arguments.trials]
    for method in arguments.methods:
        cross_validate(trials, method)


if __name__ == "__main__":
    main()

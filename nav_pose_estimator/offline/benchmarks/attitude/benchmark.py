"""Benchmark ``attitude``: filters on recorded motions with optical truth, compared with published filters."""

import argparse
import time
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.numerics.rotation import quat_from_rotvec_many, quat_multiply_many
from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.attitude.recorded import feed_recorded
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.engine.solutions import AttitudeBlock
from nav_pose_estimator.offline.benchmarks.attitude import peers as attitude_peers
from nav_pose_estimator.offline.benchmarks.attitude import report as attitude_report
from nav_pose_estimator.offline.benchmarks.attitude.row import Row
from nav_pose_estimator.offline.benchmarks.attitude.trials import CONDITIONS, Trial, errors, load_trial, rmse
from nav_pose_estimator.offline.benchmarks.tables import REPORT, SUMMARY_CSV, SUMMARY_JSON, TRIALS, chosen, write_csv
from nav_pose_estimator.offline.damaged_input import reading
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.json_file import write_json
from nav_pose_estimator.offline.output_folder import OutputFolder

METHODS = ("complementary", "two_stage")
_FIRST_NS = 1_000_000_000  # stamp of the first sample
_IN_95 = (5.991, 3.841)  # chi squared with 2 degrees of freedom (tilt) and with 1 (heading)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``benchmark attitude``."""
    add = parser.add_argument
    add("trials", nargs="+", type=Path, metavar="FILE.npz", help="gyr, acc, mag, quat, movement, fs (BROAD)")
    add("--methods", default=",".join(METHODS), metavar="M,...", help=f"of {', '.join(METHODS)} (default: both)")
    add(
        "--peers",
        nargs="?",
        const="all",
        metavar="P,...",
        help=f"also {', '.join(attitude_peers.PEERS)}: those installed",
    )
    add("--conditions", default="recorded", metavar="C,...", help=f"of {', '.join(CONDITIONS)} (default: recorded)")
    add(
        "--advance", type=float, default=0.0, metavar="S", help="extrapolate all estimates by S seconds with their rate"
    )
    add("--config", type=Path, metavar="YAML", help="parameter file, as for the nodes")
    add("--out", type=Path, default=Path("attitude_benchmark"), metavar="DIR", help="folder for tables and report")


def run(arguments: argparse.Namespace) -> int:
    """Run every filter on every trial, print the means, write tables and plots."""
    methods = chosen(arguments.methods, METHODS, "--methods")
    conditions = chosen(arguments.conditions, tuple(CONDITIONS), "--conditions")
    peers = _peers(arguments.peers)
    trials = []
    for path in arguments.trials:
        with reading(path):
            trials.append(load_trial(path))
    parameters = load_parameters(arguments.config)
    for method in methods:
        AttitudeEngine(update(parameters, {"attitude.filter": method})).warm_up()
    inputs = [*arguments.trials, *([arguments.config] if arguments.config else [])]
    with OutputFolder(arguments.out, "attitude benchmark", inputs) as folder:
        rows = [
            row
            for condition in conditions
            for trial in trials
            for row in judge(CONDITIONS[condition](trial), condition, methods, peers, parameters, arguments.advance)
        ]
        means = summarise(rows)
        folder.mkdir()
        write_files(folder, rows, means, arguments.advance)
    print(attitude_report.text_table(means))
    print(f"report: {arguments.out / REPORT}")
    return 0


def write_files(folder: Path, rows: list[Row], means: list[Row], advance: float) -> None:
    """Tables and report; ``advance`` [s] as in ``judge``."""
    write_csv(folder / TRIALS, rows, ".4f")
    write_csv(folder / SUMMARY_CSV, means, ".4f")
    write_json(folder / SUMMARY_JSON, {"means": [asdict(m) for m in means], "advance_s": advance})
    attitude_report.write_report(folder / REPORT, rows, means, advance)


def judge(
    trial: Trial,
    condition: str,
    methods: Iterable[str],
    peers: Iterable[str] = (),
    parameters: Parameters | None = None,
    advance: float = 0.0,
) -> list[Row]:
    """One row per method and peer. All estimates are extrapolated by ``advance`` [s] with the gyroscope's rate."""
    ahead = quat_from_rotvec_many(trial.gyro * advance)
    rows = []
    for method in methods:
        tree = update(parameters or Parameters(), {"attitude.filter": method})
        plain = estimate(trial, tree, False)
        begin = time.perf_counter()
        block = estimate(trial, tree, True)
        cost = (time.perf_counter() - begin) / len(trial.gyro) * 1e6
        q = quat_multiply_many(block.q_nb, ahead)
        row = _row(condition, trial, method, quat_multiply_many(plain.q_nb, ahead), q, cost)
        rows.append(_with_consistency(row, q, block, trial))
    for name in peers:
        peer = attitude_peers.PEERS[name][1]
        begin = time.perf_counter()
        q = quat_multiply_many(peer(trial, True), ahead)
        cost = (time.perf_counter() - begin) / len(trial.gyro) * 1e6
        rows.append(_row(condition, trial, name, quat_multiply_many(peer(trial, False), ahead), q, cost))
    return rows


def estimate(trial: Trial, parameters: Parameters, with_mag: bool) -> AttitudeBlock:
    """Solutions of the engine for ``trial``."""
    stamps = np.rint(trial.t * 1e9).astype(np.int64) + _FIRST_NS
    block = ImuBlock(stamps, np.ascontiguousarray(trial.gyro), np.ascontiguousarray(trial.accel))
    return feed_recorded(AttitudeEngine(parameters), block, trial.mag if with_mag else None)


def summarise(rows: list[Row]) -> list[Row]:
    """Plain means over the trials, per condition and method; ``trial`` becomes the number of trials."""
    out = []
    for condition, method in dict.fromkeys((row.condition, row.method) for row in rows):
        mine = [row for row in rows if (row.condition, row.method) == (condition, method)]
        names = list(asdict(mine[0]))[3:]
        means = {name: float(np.mean([getattr(row, name) for row in mine])) for name in names}
        out.append(Row(condition, f"{len(mine)} trials", method, **means))
    return out


def _row(condition: str, trial: Trial, method: str, q_plain: np.ndarray, q: np.ndarray, us_per_sample: float) -> Row:
    plain, full = rmse(q_plain, trial), rmse(q, trial)
    inclination, heading, total = np.degrees((plain.inclination, full.heading, full.total)).tolist()
    return Row(condition, trial.name, method, inclination, heading, total, us_per_sample=us_per_sample)


def _with_consistency(row: Row, q: np.ndarray, block: AttitudeBlock, trial: Trial) -> Row:
    use = trial.judged & ~np.isnan(trial.q_ref).any(axis=1)
    inclination, heading, _ = errors(q[use], trial.q_ref[use])
    tilt = (inclination / block.tilt_sd[use]) ** 2
    yaw = (heading / block.yaw_sd[use]) ** 2
    return replace(
        row,
        tilt_in_95=float(np.mean(tilt < _IN_95[0])),
        heading_in_95=float(np.mean(yaw < _IN_95[1])),
        tilt_nes=float(np.mean(tilt)) / 2.0,
        heading_nes=float(np.mean(yaw)),
    )


def _peers(text: str | None) -> list[str]:
    if text is None:
        return []
    here = attitude_peers.installed()
    names = chosen(text, tuple(attitude_peers.PEERS), "--peers")
    for name in names:
        if name not in here:
            print(f"note: {name} left out, the package {attitude_peers.PEERS[name][0]} is not installed")
    return [name for name in names if name in here]

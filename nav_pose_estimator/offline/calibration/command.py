"""Command ``calibrate RECORDING ... --out YAML``: calibrates magnetometer and IMU, and writes a parameter file."""

import argparse
import os
from pathlib import Path

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.logs.options import add_options, options_of
from nav_pose_estimator.offline.output_file import check_new, write_whole

DESCRIPTION = (
    "Find hard iron, soft iron and mounting of the magnetometer by how its field turns against the gyroscope, and "
    "write them as parameters. Turn the vehicle about all its axes, outdoors, away from steel; GNSS is not needed."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``calibrate``."""
    parser.description = DESCRIPTION
    parser.add_argument(
        "recordings", type=Path, nargs="+", metavar="RECORDING", help="rosbag2, PX4 .ulg, ArduPilot .bin"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="YAML", help="parameter file to write")
    parser.add_argument("--config", type=Path, metavar="YAML", help="how a bag is read (ros.input)")
    add_options(parser)
    parser.add_argument("--force", action="store_true", help="replace an existing file")


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises ``UserError`` for wrong options, and recordings that do not permit a calibration."""
    from nav_pose_estimator.engine.samples import MagSample
    from nav_pose_estimator.offline.calibration import rests as at_rest
    from nav_pose_estimator.offline.calibration.field_fit import fit_field
    from nav_pose_estimator.offline.calibration.field_pairs import field_pairs, joined
    from nav_pose_estimator.offline.calibration.parameter_file import check, parameter_file, summary
    from nav_pose_estimator.offline.flights.config_file import load_parameters
    from nav_pose_estimator.offline.logs.open_recording import open_recording

    out = os.path.realpath(arguments.out)
    for path in arguments.recordings:
        if os.path.realpath(path) in (out, os.path.dirname(out)):
            raise UserError(f"{arguments.out} is part of the recording {path}; choose another name")
    check_new(arguments.out, arguments.force)
    parameters = load_parameters(arguments.config)
    recordings = [
        open_recording(path, options_of(arguments, parameters.imu.max_gap), parameters=parameters)
        for path in arguments.recordings
    ]
    pairs, rests = [], []
    for recording in recordings:
        if not any(isinstance(sample, MagSample) for sample in recording.samples):
            raise UserError(f"{recording.path} has no magnetometer (topic imu/mag) to calibrate")
        rests.append(at_rest.find_rests(recording.imu))
        pairs.append(field_pairs(recording, rests[-1].gyro_bias))
    together = joined(pairs)
    check(together, arguments.recordings)
    fit = fit_field(together)
    text = parameter_file(fit, together, at_rest.joined(rests), recordings)
    write_whole(arguments.out, text)
    print(summary(fit))
    print(f"{arguments.out} is for --config of replay and --params-file of the nodes")
    return 0

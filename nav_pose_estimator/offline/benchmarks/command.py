"""Command ``benchmark outage | attitude | alignment | beams | speed | archive``."""

import argparse
from collections.abc import Callable
from importlib import import_module
from typing import Any

PARTS = {
    "outage": "forced GNSS outages over many bags and methods",
    "attitude": "attitude errors on recorded motions with optical truth",
    "alignment": "fine alignment in simulation, by model of the measurement noise",
    "beams": "drift without GNSS while beams of a Doppler sensor fail, in simulation",
    "speed": "what everything costs on this machine",
    "archive": "what many recordings cost, and what a killed process loses",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmarks."""
    parser.description = "Measure the package: drift in GNSS outages, attitude, alignment, beams, speed."
    kind = type("_Part", (_WithLateArguments, type(parser)), {})
    parts: Any = parser.add_subparsers(dest="part", required=True, metavar=f"{{{','.join(PARTS)}}}", parser_class=kind)
    for name, what in PARTS.items():
        parts.add_parser(name, help=what, description=what).arguments_by(
            lambda part, name=name: _module(name).add_arguments(part)
        )


def run(arguments: argparse.Namespace) -> int:
    """Run the chosen benchmark."""
    return _module(arguments.part).run(arguments)


def _module(part: str) -> Any:
    return import_module(f"nav_pose_estimator.offline.benchmarks.{part}.benchmark")


class _WithLateArguments(argparse.ArgumentParser):
    """Parser that adds its arguments when it parses, so that only the chosen benchmark is imported."""

    def arguments_by(self, add: Callable[[argparse.ArgumentParser], None]) -> None:
        """Set the function ``add`` that adds the arguments."""
        self._add: Callable[[argparse.ArgumentParser], None] | None = add

    def parse_known_args(self, args=None, namespace=None):  # type: ignore[override]
        """Add the arguments, then parse."""
        add, self._add = self._add, None
        if add is not None:
            add(self)
        return super().parse_known_args(args, namespace)

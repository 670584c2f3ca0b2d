"""Command line options that the tools share."""

from __future__ import annotations

import argparse


def spread(text: str) -> float:
    """A standard deviation."""
    value = float(text)
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError("a standard deviation is a number that is not negative")
    return value


def add_drift(parser: argparse.ArgumentParser) -> None:
    """Options for what changes from job to job."""
    parser.add_argument("--kelvin", type=spread, default=0.0, metavar="K", help="standard deviation of the air temperature [K] (0)")
    parser.add_argument(
        "--hammer", type=spread, default=0.0, metavar="M", help="standard deviation of the hits along x and along y [m] (0)"
    )
    parser.add_argument("--gain", type=spread, default=0.0, metavar="DB", help="standard deviation of each response's gain [dB] (0)")

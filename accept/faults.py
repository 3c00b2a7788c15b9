"""Faults: nothing lost, nothing left, nothing hangs.

Usage: python -m accept.faults [--smoke] [CHECK ...]: all checks, or the named ones; exit code 1 where a bound is
missed.
"""

from __future__ import annotations

import sys

from accept.bad_inputs import measure_bad_inputs, measure_mutants, measure_unusual_images
from accept.failing_starts import measure_failing_starts
from accept.full_disks import measure_full_disks
from accept.kills_and_signals import measure_kills_and_signals
from accept.outputs_onto_inputs import measure_outputs_onto_inputs
from accept.resumed_series import measure_resumed_series
from accept.same_inputs import measure_same_inputs
from accept.surroundings import measure_surroundings
from accept.table import Check, run_table

CHECKS: dict[str, Check] = {
    "bad_inputs": measure_bad_inputs, "mutants": measure_mutants, "kills_and_signals": measure_kills_and_signals,
    "failing_starts": measure_failing_starts, "full_disks": measure_full_disks,
    "outputs_onto_inputs": measure_outputs_onto_inputs, "resumed_series": measure_resumed_series,
    "same_inputs": measure_same_inputs, "unusual_images": measure_unusual_images, "surroundings": measure_surroundings,
}

if __name__ == "__main__":
    sys.exit(run_table("faults", CHECKS))

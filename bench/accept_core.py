"""The acceptance table of the core: every check measured here and now; exit 1 where one falls short.

Usage: accept_core.py [NAME ...], with the names of the checks' own scripts; all by default.
"""

from __future__ import annotations

import importlib
import sys
from dataclasses import asdict

from support.harness import Row, append_result

CHECKS = ("accuracy", "demo_noise", "linear_step", "preconditioners", "openhole", "sample14", "full_size")


def measured(name: str) -> list[Row]:
    """The rows of one check; a check that cannot be measured is a row that does not hold."""
    try:
        rows: list[Row] = importlib.import_module(name).measure()
    except (RuntimeError, OSError, ImportError) as error:
        return [Row(name, "measured", f"could not be measured: {error}", False)]
    return rows


def main() -> int:
    chosen = sys.argv[1:] or CHECKS
    unknown = sorted(set(chosen) - set(CHECKS))
    if unknown:
        print(f"no such check: {', '.join(unknown)}; there are: {', '.join(CHECKS)}", file=sys.stderr)
        return 2
    held = True
    for name in chosen:
        for row in measured(name):
            append_result("accept_core", {"name": name, **asdict(row)})
            held &= row.holds
            print(f"{'holds' if row.holds else 'FAILS'}  {row.check}\n       bound     {row.bound}\n"
                  f"       measured  {row.measured}\n       command   make accept-core CHECK={name}", flush=True)
    print("every bound holds" if held else "some bounds do not hold")
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())

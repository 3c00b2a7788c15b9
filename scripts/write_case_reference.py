"""Write the tables of docs/case-file.md from the schema; with --check, fail where they differ from it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ddic.case.reference import write_tables

DOCUMENT = Path(__file__).parents[1] / "docs" / "case-file.md"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; exit code 1 where the tables are old")
    check = parser.parse_args().check
    committed = DOCUMENT.read_text(encoding="utf-8")
    written = write_tables(committed)
    if written == committed:
        return 0
    if check:
        print(f"{DOCUMENT}: its tables are not those of the schema; run python scripts/write_case_reference.py")
        return 1
    DOCUMENT.write_text(written, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

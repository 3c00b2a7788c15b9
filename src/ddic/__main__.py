"""``python -m ddic`` is ``ddic``."""

from ddic.cli.entry import main

main()

"""``python -m ddic`` is ``ddic``; ``python -m mpi4py -m ddic`` also ends all ranks on an error in start-up."""

from ddic.cli.app import main

main()

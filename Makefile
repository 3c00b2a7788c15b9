# make demo and make test set everything up first; the stamp makes a second call cost nothing.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

PYTHON := .venv/bin/python
STAMP := .venv/.ddic-setup
# Processes at a time of the benchmarks that count and do not time.
JOBS ?= 2

.PHONY: help setup demo test lint bench bench-iterations bench-interface accept-core accept-solver clean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 22

setup: $(STAMP) ## install everything into .venv (done by the other targets when needed)

$(STAMP): pyproject.toml constraints/debian.txt scripts/setup.sh
	@bash scripts/setup.sh

demo: setup ## render a plate with a hole in tension, measure it on two ranks, print the error
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; bash examples/demo/run.sh

test: setup ## run all tests: serial, then on 1, 2, 3 and 4 ranks
	@bash scripts/run_tests.sh

lint: setup ## ruff, mypy, the import contracts, and the import under numpy 2
	$(PYTHON) -m ruff check .
	$(PYTHON) -m mypy
	$(PYTHON) -c "from importlinter.cli import lint_imports_command as run; run()"
	bash scripts/check_numpy2.sh

bench: setup ## run every benchmark; results go to bench/results
	@bash scripts/run_bench.sh

bench-iterations: setup ## iterations of the interface problem over the grid l_c/H x subdomains
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) bench/iterations.py --jobs $(JOBS)

bench-interface: setup ## time and memory of the interface solvers, direct solvers and multigrid; takes hours
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) bench/interface_solvers.py

accept-core: setup ## measure the acceptance table (CHECK=NAME: one check); non-zero exit where a bound is missed
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) bench/accept_core.py $(CHECK)

accept-solver: setup ## measure the interface solver's acceptance table (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) bench/accept_solver.py --jobs $(JOBS) $(CHECK)

clean: ## remove the environments and caches
	rm -rf .venv .venv-numpy2 .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +

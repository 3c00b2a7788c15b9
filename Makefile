# make demo and make test install what they need first; stamps make a second call cost nothing.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

PYTHON := .venv/bin/python
INSTALL_STAMP := .venv/.ddic-install
SETUP_STAMP := .venv/.ddic-setup
BENCH_STAMP := .venv/.ddic-bench
DOCS_STAMP := .venv/.ddic-docs
# Processes at a time of the benchmarks that count and do not time.
JOBS ?= 2
# Side of the images of bench-big, pixels.
SIZE ?= 22000

# Each of the many processes would else compile all modules anew, where the environment says so.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install setup page demo test test-programs test-slurm test-hosts lint docs papers pictures bench bench-iterations bench-interface bench-paper bench-peers bench-before bench-big bench-scaling \
	bench-threads accept accept-stale accept-judge accept-core accept-solver accept-performance accept-near-far accept-house accept-right accept-xdic accept-start accept-pgd \
	accept-impressions accept-practice accept-faults accept-scale accept-clean accept-trust accept-newcomer accept-papers accept-volumes accept-identify trials smoke clean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 22

install: $(INSTALL_STAMP) ## install ddic and what it needs into .venv (done by make demo when needed)

setup: $(SETUP_STAMP) ## the same with the tools of tests and lint (done by all other targets when needed)

$(INSTALL_STAMP): pyproject.toml constraints/debian.txt scripts/setup.sh
	@bash scripts/setup.sh

$(SETUP_STAMP): pyproject.toml constraints/debian.txt scripts/setup.sh
	@bash scripts/setup.sh dev

$(BENCH_STAMP): $(SETUP_STAMP)
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --only-binary=petsc,petsc4py --no-build-isolation --editable '.[bench]'
	@touch $@

$(DOCS_STAMP): $(SETUP_STAMP)
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --only-binary=petsc,petsc4py --no-build-isolation --editable '.[docs]'
	@touch $@

page: install ## what ddic draw and ddic view need besides (make setup has it)
	@$(PYTHON) -m pip install --quiet --disable-pip-version-check --only-binary=petsc,petsc4py --no-build-isolation --editable '.[page]'

demo: install ## render a plate with a hole in tension, measure it on two ranks, print the error
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; bash examples/demo/run.sh

test: setup ## run the tests: on one process a core, then on 2, 3 and 4 ranks
	@bash scripts/run_tests.sh

test-programs: setup ## run the tests that start whole programs: jobs under mpirun, examples, scripts
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m pytest -n auto --dist loadgroup -m program

test-slurm: setup ## run the Slurm tests on a Slurm of this machine; needs slurm-wlm, munge and libpmix-dev, and root
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; DDIC_TEST_SLURM=1 $(PYTHON) -m pytest tests/cluster/test_slurm.py

test-hosts: setup ## run the tests on two hosts, which are network namespaces of this machine; needs root
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; DDIC_TEST_HOSTS=1 $(PYTHON) -m pytest tests/cluster/test_two_hosts.py

lint: setup ## ruff, mypy, docstrings, the import contracts, and the import under numpy 2
	$(PYTHON) -m ruff check .
	$(PYTHON) -m mypy
	$(PYTHON) scripts/check_docstrings.py
	$(PYTHON) -c "from importlinter.cli import lint_imports_command as run; run()"
	bash scripts/check_numpy2.sh

pictures: $(DOCS_STAMP) ## draw all pictures of the documentation anew, minutes; those that look as before stay
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) scripts/tour_pictures.py

papers: $(BENCH_STAMP) ## draw the four papers' figures and tables beside ours and bring docs/papers.md up to date, minutes (ARGS=bp17_beam: one chapter)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m bench.papers $(ARGS)

docs: $(DOCS_STAMP) ## build the documentation into site/, without a warning
	$(PYTHON) -m mkdocs build --strict --quiet
	@echo "site/index.html"

bench: setup ## run every benchmark; results go to bench/results
	@bash scripts/run_bench.sh

bench-iterations: setup ## iterations of the interface problem over the grid l_c/H x subdomains
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m bench.iterations --jobs $(JOBS)

bench-interface: setup ## time and memory of the interface solvers, direct solvers and multigrid, and the costs by which auto chooses; takes hours
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m bench.interface_solvers

bench-paper: $(BENCH_STAMP) ## the 29-megapixel case on 2 ranks: time by phase, memory, error, rates (ARGS="beam_8 --repeats 1")
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m bench.paper $(ARGS)

bench-peers: setup ## CPU time and error beside other programs, which are installed into bench/data
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m bench.peers $(ARGS)

bench-big: setup ## a SIZE x SIZE px pair on 2 ranks, 22,000 by default: time by phase, memory
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m bench.big --size $(SIZE)

bench-before: $(BENCH_STAMP) ## the whole command beside an older commit, in turn: wall time, CPU time, memory (ARGS="demo --rounds 1")
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m bench.before $(ARGS)

bench-scaling: setup ## work by rank, messages and bytes on 4 to 144 oversubscribed ranks
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m bench.scaling $(ARGS)

bench-threads: setup ## one thread against two on one rank, phase by phase
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m bench.threads $(ARGS)

accept: $(BENCH_STAMP) $(DOCS_STAMP) ## measure every check of every acceptance table that accept/ledger.json lacks or holds with older code; hours, interrupted runs go on
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.all_tables run --jobs $(JOBS)

accept-stale: setup ## list the checks that were measured before the code that they run was last changed (RUN=1: measure them)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.all_tables stale --jobs $(JOBS) $(if $(RUN),--run)

accept-judge: setup ## judge accept/ledger.json: non-zero exit where a check is missing or a row misses its bound
	@$(PYTHON) -m accept.all_tables judge

accept-core: setup ## measure the acceptance table (CHECK=NAME: one check); non-zero exit where a bound is missed
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables core $(CHECK)

accept-solver: setup ## measure the interface solver's acceptance table (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables solver --jobs $(JOBS) $(CHECK)

accept-performance: $(BENCH_STAMP) ## measure the performance acceptance table (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables performance $(CHECK)

accept-near-far: setup ## measure the acceptance table of near-field and far-field images (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables near-far $(CHECK)

accept-house: $(BENCH_STAMP) $(DOCS_STAMP) ## measure the table of the house: fields and rates as before, pages, source (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables house $(CHECK)

accept-right: $(BENCH_STAMP) $(DOCS_STAMP) ## measure the table of right numbers: moved specimens, masks, cut-off wavelengths, edges, rates on the beam (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables right $(CHECK)

accept-xdic: setup ## measure the table of discontinuities (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables xdic $(CHECK)

accept-start: setup ## measure the table of the start, as far as it is built (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables start $(CHECK)

accept-pgd: setup ## measure the table of PGD-DIC (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables pgd $(CHECK)

accept-impressions: setup ## measure the table of first impressions: the chosen solver, pages, packages, strain at nodes, pictures (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables impressions $(CHECK)

accept-practice: setup ## measure the table of daily work: series, clusters, uncertainty, recommended settings, the report (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables practice $(CHECK)

accept-faults: setup ## measure the table of faults: bad inputs, damaged files, killed runs (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables faults --jobs $(JOBS) $(CHECK)

accept-scale: $(BENCH_STAMP) ## measure the table of many ranks and gigapixels, then fields and faults as before (CHECK=NAME: one check); half an hour
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables scale $(CHECK); held=$$?; \
	test -n "$(CHECK)" || { $(PYTHON) -m accept.tables house recorded || held=1; \
	$(PYTHON) -m accept.tables faults --jobs $(JOBS) kills_and_signals full_disks outputs_onto_inputs || held=1; }; \
	exit $$held

accept-clean: $(BENCH_STAMP) ## measure the table of clean pairs: what they pay for what spoils others (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables clean $(CHECK)

accept-volumes: $(BENCH_STAMP) ## measure the table of volumes (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables volumes $(CHECK)

accept-identify: setup ## measure the table of simulations beside fields, and of materials from images (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables identify --jobs $(JOBS) $(CHECK)

accept-papers: $(BENCH_STAMP) ## measure the table of the four papers' figures, and of lines found by themselves (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables papers $(CHECK)

accept-trust: setup ## measure the table of numbers that hold or are nan where something is off: lines (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables trust $(CHECK)

accept-newcomer: setup ## measure the table of a new user's day: verdicts, pages in the browser, the environment (CHECK=NAME: one check)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.tables newcomer $(CHECK)

trials: setup ## try bad inputs and damaged files (ARGS="--sample 40": some; ARGS=mesh.file: those of a name)
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.bad_inputs --jobs $(JOBS) $(ARGS)

smoke: setup ## run every check of every acceptance table on tiny cases, and judge what is no time, memory or large case: minutes
	@. scripts/mpi_env.sh; export PATH="$$PWD/.venv/bin:$$PATH"; $(PYTHON) -m accept.smoke

clean: ## remove the environments and caches
	rm -rf site .venv .venv-numpy2 .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +

# Everything runs in .venv; the first target that needs it makes it. `make PYTHON=python3.12 demo` chooses another Python.

PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
PIP := $(RUN) -m pip --disable-pip-version-check install --quiet --no-compile

# The tests start some hundred processes. Without bytecode on disk each of them would compile all of our files again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo quick test studies kernels compare clients machines lint types benchmarks docs release wheel-test coverage fuzz mutants benchmark-history clean

help:
	@echo "make demo        a race to watch, then the paper's study in small: trees, networks, races, a report (under 5 minutes)"
	@echo "make quick       style, types, and the tests of the rooms that you changed (FROM=origin/main: since that branch)"
	@echo "make test        the test suite"
	@echo "make studies     the tests of studies/, whose experiments answered a question once (once a week in CI)"
	@echo "make kernels     compile what races and environments need, which the tests do first"
	@echo "make compare     comparisons with other libraries (Gambit and others), which it installs"
	@echo "make clients     other RL libraries on the environments, each in an environment of its own (half an hour the first time)"
	@echo "make machines    the test suite as other machines would run it; PYTHONS=\"python3.12 python3.13\" adds those"
	@echo "make lint        style, and the format of the code"
	@echo "make types       static types"
	@echo "make benchmarks  every figure of the documentation, measured again"
	@echo "make coverage    the tests again with coverage, compiled files as plain Python (a quarter of an hour of processor time)"
	@echo "make fuzz        20 minutes of broken inputs for every loader and environment; goes on where it was left"
	@echo "make mutants     small faults put into the code, and which tests notice them (hours); goes on where it was left"
	@echo "make benchmark-history  a few ratios of speed, compared with dev/benchmarks/history.csv and added to it"
	@echo "make docs        the documentation's site, in out/docs; a warning is an error"
	@echo "make release     sdist and wheel, in dist, built and checked"
	@echo "make wheel-test  the wheel in a clean environment: base, extras, the quick study (some minutes)"
	@echo "make clean       remove results and caches, but not $(VENV)"

# A race comes first: within two minutes there is something to watch, and the study needs the same kernels.
demo: $(VENV)/base.stamp
	mkdir -p out
	$(VENV)/bin/pcs-racing race --replay out/race.html
	$(VENV)/bin/pcs-racing study quick --out out/demo

# The kernels are compiled once before the tests begin, rather than by every worker at the same time. Linear algebra keeps
# to one thread: several in each worker, and in the processes that these start, would fight for two cores. Of four
# workers one or two usually wait for a cluster, a browser or a killed process.
test: export OMP_NUM_THREADS = 1
test: export OPENBLAS_NUM_THREADS = 1
test: kernels
	$(RUN) -m pytest -n 4 --dist worksteal

FROM ?= HEAD
quick: export OMP_NUM_THREADS = 1
quick: lint types
	$(RUN) dev/tools/quick.py --against $(FROM)

studies: export OMP_NUM_THREADS = 1
studies: export OPENBLAS_NUM_THREADS = 1
studies: kernels
	$(RUN) -m pytest studies/tests -n 2 --dist worksteal

kernels: $(VENV)/test.stamp
	$(VENV)/bin/pcs-racing compile

# Some of these libraries are large, so that nothing else waits for them.
compare: $(VENV)/compare.stamp
	$(RUN) -m pytest -m compare -rs

clients: | $(RUN)
	$(RUN) dev/tools/try_clients.py

PYTHONS ?=
machines: $(VENV)/test.stamp
	$(RUN) dev/tools/try_machines.py --pythons $(PYTHONS)

lint: $(VENV)/test.stamp
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .

types: $(VENV)/test.stamp
	$(RUN) -m mypy

# Lines of compiled functions leave no trace: a part of the tests runs once more as plain Python, where numpy warns of
# overflows and of 0 / 0, which are meant. Real circuits are left out there: they would take minutes to build.
INTERPRETED := tests/interpreted tests/pcs_racing/car/test_collision.py tests/pcs_racing/track/test_grid.py \
	tests/pcs_racing/car/test_ittc.py tests/pcs_racing/car/test_vehicle.py tests/pcs_racing/track/building/test_clearance.py \
	tests/pcs_racing/car/test_lidar.py tests/pcs_racing/track/test_frenet.py tests/pcs_racing/race/test_race_kernel.py \
	tests/pcs_racing/envs/test_drive_kernel.py tests/pcs_racing/envs/test_game_batch.py \
	tests/pcs_racing/track/building/test_curves.py tests/pcs_racing/track/building/test_raceline.py \
	tests/pcs_racing_agents/networks/test_regret_network.py tests/pcs_racing_agents/solvers/test_cfr.py \
	tests/pcs_racing_agents/solvers/test_matrix_games.py
COVERED := $(RUN) -m pytest --cov --cov-report= --cov-fail-under=0

coverage: $(VENV)/test.stamp
	$(VENV)/bin/pcs-racing compile
	$(COVERED) -n 2 --dist worksteal
	NUMBA_DISABLE_JIT=1 PCS_RACING_MAPS=none $(COVERED) --cov-append -p no:xdist $(INTERPRETED) \
		-W ignore::RuntimeWarning
	$(RUN) -m coverage report --include "pcs_racing/*"
	$(RUN) -m coverage report --include "pcs_racing_agents/*"

fuzz: $(VENV)/test.stamp
	$(RUN) dev/tools/fuzz.py run --minutes 20

mutants: $(VENV)/test.stamp
	$(RUN) dev/tools/mutants.py run --suite

benchmark-history: $(VENV)/test.stamp
	$(RUN) dev/benchmarks/record.py --check
	$(RUN) dev/benchmarks/record.py --add

# What pools finished studies needs their folders, and is run by hand.
benchmarks: $(VENV)/compare.stamp
	@for script in $(filter-out dev/benchmarks/pooled_studies.py,$(wildcard dev/benchmarks/*.py)); do echo "== $$script"; $(RUN) "$$script" || exit 1; done

docs: export OMP_NUM_THREADS = 1
docs: $(VENV)/docs.stamp
	$(RUN) -m sphinx --fail-on-warning --keep-going --builder html --doctree-dir out/doctrees docs out/docs
	@echo "out/docs/index.html"

release: $(VENV)/release.stamp
	rm -rf dist
	$(RUN) -m build
	$(RUN) -m twine check --strict dist/*

wheel-test: release
	$(RUN) dev/tools/try_wheel.py dist --parts base demo

clean:
	rm -rf out build dist docs/generated .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path "./$(VENV)/*" -prune -exec rm -rf {} +

# The stamps keep pip from running again until pyproject.toml changes. Wheels only: nothing here may need a compiler.

$(RUN):
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("Python 3.11 or newer is needed: make PYTHON=...")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/base.stamp: pyproject.toml | $(RUN)
	@echo "installing into $(VENV), PyTorch included (some minutes, once)"
	$(PIP) --editable ".[mapping,plots,learning]"
	@touch $@

$(VENV)/test.stamp: pyproject.toml | $(RUN)
	@echo "installing into $(VENV), PyTorch included (some minutes, once)"
	$(PIP) --only-binary=:all: --editable ".[test,lint]"
	@touch $@ $(VENV)/base.stamp

$(VENV)/compare.stamp: $(VENV)/test.stamp
	$(PIP) --editable ".[compare]"
	@touch $@

$(VENV)/docs.stamp: pyproject.toml | $(RUN)
	$(PIP) --editable ".[docs]"
	@touch $@

$(VENV)/release.stamp: pyproject.toml | $(RUN)
	$(PIP) --editable ".[release]"
	@touch $@

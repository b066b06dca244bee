# Everything runs in .venv; the first target that needs it makes it. `make PYTHON=python3.12 demo` chooses another Python.

PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
PIP := $(RUN) -m pip --disable-pip-version-check install --quiet --no-compile

# Without bytecode on disk each process that a test starts would compile all of our files again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install demo quick test lint docs release

help:
	@echo "make install  the package for development, in $(VENV)"
	@echo "make demo     a race to watch, then the paper's study in small: trees, networks, races, a report (about 2 minutes)"
	@echo "make quick    style, types, and the tests of the rooms that you changed (FROM=origin/main: since that branch)"
	@echo "make test     the tests; those of browsers, clusters and trainers where their rooms changed (since FROM)"
	@echo "make lint     style, format and types of the code"
	@echo "make docs     the documentation's site, in out/docs; a warning is an error"
	@echo "make release  sdist and wheel, in dist, built and checked"

install: $(VENV)/test.stamp

# A race comes first: within a minute there is something to watch, and the study needs the same kernels.
demo: $(VENV)/base.stamp
	mkdir -p out
	$(VENV)/bin/pcs-racing race --replay out/race.html
	$(VENV)/bin/pcs-racing study quick --out out/demo
	$(VENV)/bin/pcs-racing view out/demo --replays 12 --no-open
	@echo "Open in a browser: out/race.html (a race), out/demo/report.html (the study), out/demo/view.html (its races)"

# Several threads of linear algebra in each process would fight for the cores.
quick test docs: export OMP_NUM_THREADS = 1
quick test docs: export OPENBLAS_NUM_THREADS = 1

FROM ?= HEAD
quick: lint
	$(RUN) dev/tools/quick.py --against $(FROM)

# The kernels are compiled once before the tests begin, rather than by every worker at the same time. Each worker
# imports all tests: more than two spend more on that than they save.
test: $(VENV)/test.stamp
	$(VENV)/bin/pcs-racing compile
	$(RUN) -m pytest -n 2 --dist worksteal -m "$$($(RUN) dev/tools/quick.py --marks --against $(FROM))"

lint: $(VENV)/test.stamp
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .
	$(RUN) -m mypy

docs: $(VENV)/docs.stamp
	$(RUN) -m sphinx --fail-on-warning --keep-going --builder html --doctree-dir out/doctrees docs out/docs
	@echo "out/docs/index.html"

release: $(VENV)/release.stamp
	rm -rf dist
	$(RUN) -m build
	$(RUN) -m twine check --strict dist/*

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

$(VENV)/docs.stamp: pyproject.toml | $(RUN)
	$(PIP) --editable ".[docs]"
	@touch $@

$(VENV)/release.stamp: pyproject.toml | $(RUN)
	$(PIP) --editable ".[release]"
	@touch $@

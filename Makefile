# Everything a fresh machine needs: `make demo` sets up and runs the main job, `make test` sets up and runs the tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Test processes, one per core; nproc would obey a thread count that the user has set.
WORKERS ?= $(shell env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc)
# One thread a process: parallel work runs one process a core.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export NUMBA_NUM_THREADS := 1

.PHONY: help setup demo test lint format wheel-check clean

help:
	@echo "make setup        create .venv with gelgap and its tested dependencies, and install libosmesa6 if missing"
	@echo "make demo         set up, then run the main job end to end: domains, adaptation, report (minutes)"
	@echo "make test         set up, then lint and run the test suite"
	@echo "make lint         ruff check, ruff format --check, and mypy over the public names"
	@echo "make wheel-check  build the wheel and try it from a fresh environment in another folder"

setup: $(VENV)/.ready

$(VENV)/.ready: pyproject.toml constraints.txt scripts/install-osmesa
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "gelgap needs Python >= 3.11; run: make PYTHON=python3.11 setup"; exit 1; }
	scripts/install-osmesa
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[test]'
	touch $@

demo: setup
	$(BIN)/gelgap demo

test: setup lint
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python scripts/check_types.py

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

wheel-check: setup
	scripts/wheel-check

clean:
	rm -rf $(VENV) build dist *.egg-info

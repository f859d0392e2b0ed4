# Everything a fresh machine needs: `make demo` sets up and runs the main job, `make test` sets up and runs the tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALL = $(BIN)/python -m pip install --disable-pip-version-check --constraint constraints.txt --editable
# Test processes, one per core; nproc would obey a thread count that the user has set.
WORKERS ?= $(shell env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc)
# One thread a process: parallel work runs one process a core.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export NUMBA_NUM_THREADS := 1

# Settings under which this processor computes as others do; the last one needs AVX-512.
CODE_PATH_old-mkl := MKL_CBWR=COMPATIBLE OPENBLAS_CORETYPE=Haswell
CODE_PATH_sse4 := MKL_ENABLE_INSTRUCTIONS=SSE4_2 ATEN_CPU_CAPABILITY=default ONEDNN_MAX_CPU_ISA=SSE41
CODE_PATH_nehalem := OPENBLAS_CORETYPE=Nehalem NUMBA_CPU_NAME=generic NPY_DISABLE_CPU_FEATURES=X86_V3
CODE_PATH_skylakex := OPENBLAS_CORETYPE=SkylakeX
CODE_PATHS := old-mkl sse4 nehalem $(shell grep -q avx512 /proc/cpuinfo && echo skylakex)
# Another one each day of the year.
TODAY := $(word $(shell expr $$(date +%j) % $(words $(CODE_PATHS)) + 1),$(CODE_PATHS))

.PHONY: help setup demo view test test-slow test-todays-code-path test-code-paths lint format docs links wheel-check clean

help:
	@echo "make setup        create .venv with gelgap, its tested dependencies and what tests need, and install libosmesa6 if missing"
	@echo "make demo         create .venv with gelgap alone, then run the main job end to end: domains, adaptation, report (minutes)"
	@echo "make view         create .venv with gelgap and viser, and open the page in the browser"
	@echo "make test         set up, then lint and run the test suite"
	@echo "make test-slow    the tests that make test leaves out: longer forms of some"
	@echo "make test-code-paths  the numerical tests as other processors compute them, for a release"
	@echo "make test-todays-code-path  the same as one other processor does, another one each day"
	@echo "make lint         ruff check, ruff format --check, and mypy"
	@echo "make docs         make the site in build/site; its examples and notebooks run (minutes)"
	@echo "make links        make the site, and follow its links to other sites; its own are checked by make docs"
	@echo "make wheel-check  build the wheel and try it from a fresh environment in another folder"

setup: $(VENV)/.ready

$(VENV)/.installed: pyproject.toml constraints.txt scripts/install-osmesa
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "gelgap needs Python >= 3.11; run: make PYTHON=python3.11 setup"; exit 1; }
	scripts/install-osmesa
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --upgrade 'pip>=25.1'
	$(INSTALL) .
	touch $@

$(VENV)/.ready: $(VENV)/.installed
	$(INSTALL) '.[test]'
	touch $@

$(VENV)/.view: $(VENV)/.installed
	$(INSTALL) '.[view]'
	touch $@

demo: $(VENV)/.installed
	$(BIN)/gelgap demo

view: $(VENV)/.view
	$(BIN)/gelgap view

test: setup lint
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -m 'not slow'

test-slow: setup
	$(BIN)/python -m pytest -n $(WORKERS) -m slow

test-code-paths: $(CODE_PATHS:%=test-code-path-%)

test-todays-code-path: test-code-path-$(TODAY)

test-code-path-%: setup
	@echo "code path $*: $(CODE_PATH_$*)"
	$(CODE_PATH_$*) $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -m 'numerical and not slow' \
		tests/sim tests/render tests/adapt

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python scripts/check_types.py

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: setup
	$(INSTALL) '.[docs]'
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --conf-dir docs --doctree-dir build/doctrees . build/site
	@echo '<meta http-equiv="refresh" content="0; url=docs/index.html">' > build/site/index.html
	@echo "open build/site/index.html"

links: docs
	$(BIN)/python scripts/check_links.py

wheel-check: setup
	scripts/wheel-check

clean:
	rm -rf $(VENV) build dist *.egg-info

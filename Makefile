# Everything runs in a virtual environment of the checkout; `make catalog` and `make test` need nothing else.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check

unexport PYTHONDONTWRITEBYTECODE  # processes that start later need not compile the modules again

.DELETE_ON_ERROR:
.PHONY: all venv catalog test check test-slow docs wheel evidence bench bench-build bench-peers bench-query bench-merge soak \
        flight coverage mutants help clean

all: catalog

venv: $(READY)

$(READY): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "lcp needs Python 3.11 or newer: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --upgrade 'pip>=25.1'
	$(INSTALL) --editable . --group dev
	touch $@

SAMPLE := --no-print-directory --always-make -C sample_data LCP=$(abspath $(BIN))/lcp OUT=../build

catalog: $(READY) ## sample catalogue, its report, validation and two renders, in build/
	@$(MAKE) $(SAMPLE) ../build/hadley.h5
	@echo "side by side: its report, its validation and two renders, each told when it is done"
	@$(MAKE) $(SAMPLE) --old-file=../build/hadley.h5 $(if $(filter -j%,$(MAKEFLAGS)),,$(if $(filter output-sync,$(.FEATURES)),--jobs=2 --output-sync=target))

test: $(READY) ## the fast tests
	$(BIN)/lcp warm-up
	$(BIN)/python -m pytest -m 'not slow' -n auto --maxprocesses 4 --dist loadfile

check: $(READY) ## lint, format, types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test-slow: $(READY) ## the long tests, and those of hypothesis with all their examples
	LCP_ALL_EXAMPLES=1 $(BIN)/python -m pytest -m 'slow or hypothesis' -n auto --maxprocesses 4 --dist loadfile

docs: $(READY) ## the documentation as a site, build/site/index.html
	$(INSTALL) --group docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "docs       build/site/index.html (its search needs a server: $(BIN)/python -m http.server -d build/site)"

wheel: $(READY) ## source distribution, wheel, and wheel with compiled kernels for this platform, in build/dist
	$(INSTALL) build
	$(BIN)/python -m build --outdir build/dist
	$(BIN)/python packaging/pack_wheel.py build/dist/lcp_catalog-*-py3-none-any.whl

evidence: $(READY) ## photographs and simulated frames: what is claimed against what happens (LCP_SHARED_DATA: their folder)
	$(BIN)/python -m benchmarks.evidence all

bench: $(READY) ## points matched a second; plans and areas of the Moon's belt
	$(BIN)/python -m benchmarks.speed matching
	$(BIN)/python -m benchmarks.speed scale

bench-build: $(READY) ## a build by stage, beside a plain and a strong pipeline and beside another commit
	$(BIN)/python -m benchmarks.speed build areas regions commit

bench-peers: $(READY) ## shadows and camera rays beside Mitsuba and Embree
	$(INSTALL) --group peers
	$(BIN)/python -m benchmarks.speed peers
	$(BIN)/python -m benchmarks.speed render

bench-query: $(READY) ## frames and trajectories asked of 100 000 points
	$(BIN)/python -m benchmarks.speed query

bench-merge: $(READY) ## the merge of a million points, and the check of 100 000 finished areas
	$(BIN)/python -m benchmarks.speed merge

soak: $(READY) ## kills, full disks, damaged files and damaged inputs, for hours
	$(BIN)/python -m benchmarks.faults all

flight: $(READY) ## the C reference of the flight file: its vector, sanitizers, 7200 points of frames beside Python, and what it needs
	$(BIN)/python -m pytest tests/flight
	$(BIN)/python -m benchmarks.flight

coverage: $(READY) ## the fast tests with the share of lines that they run
	$(INSTALL) --group coverage
	$(BIN)/python -m pytest -m 'not slow' -n auto --maxprocesses 4 --dist loadfile --cov --cov-report=term

mutants: $(READY) ## mutation testing
	$(INSTALL) --group mutants
	NUMBA_THREADING_LAYER=workqueue $(BIN)/mutmut run  # each mutant is a fork, which OpenMP ends
	$(BIN)/mutmut results

help: ## this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  \1|\2/p' $(MAKEFILE_LIST) | awk -F '|' '{ printf "%-14s %s\n", $$1, $$2 }'

clean: ## remove build/ and caches
	rm -rf build .pytest_cache .hypothesis .ruff_cache .mypy_cache

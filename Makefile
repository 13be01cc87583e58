# Everything runs in a virtual environment of the checkout; `make catalog` and `make test` need nothing else.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

unexport PYTHONDONTWRITEBYTECODE  # processes that start later need not compile the modules again

.DELETE_ON_ERROR:
.PHONY: coverage mutants all catalog docs evidence test test-slow check bench bench-build bench-merge bench-peers soak clean bench-moon bench-query bench-plan venv wheel

all: catalog

venv: $(READY)

$(READY): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "lcp needs Python 3.11 or newer: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --upgrade 'pip>=25.1'
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable . --group dev
	touch $@

catalog: $(READY)
	@$(MAKE) --no-print-directory --always-make -C sample_data LCP=$(abspath $(BIN))/lcp OUT=../build

docs: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --group docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "docs       build/site/index.html (its search needs a server: $(BIN)/python -m http.server -d build/site)"

evidence: $(READY)  # LCP_SHARED_DATA: the folder of the lunar photographs and DEMs
	$(BIN)/python benchmarks/evidence.py --suns

test: $(READY)
	$(BIN)/python -m pytest -m 'not slow' -n auto --maxprocesses 4 --dist loadfile

test-slow: $(READY)
	$(BIN)/python -m pytest -m slow

coverage: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --group coverage
	$(BIN)/python -m pytest -m 'not slow' -n auto --maxprocesses 4 --dist loadfile --cov --cov-report=term

mutants: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --group mutants
	$(BIN)/mutmut run
	$(BIN)/mutmut results

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(READY)
	$(BIN)/python -m pytest benchmarks --benchmark-enable --benchmark-sort=name

bench-build: $(READY)
	$(BIN)/python benchmarks/build.py areas roofline memory jobs

bench-moon: $(READY)
	$(BIN)/python benchmarks/moon.py plan maps areas

soak: $(READY)
	$(BIN)/python -m benchmarks.faults all

bench-query: $(READY)
	PYTHONPATH=tests OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/query.py

bench-merge: $(READY)
	PYTHONPATH=tests $(BIN)/python benchmarks/merge.py

bench-plan: $(READY)
	$(BIN)/python benchmarks/plan.py

bench-peers: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --group peers
	$(BIN)/python benchmarks/peers.py 2048 4096

wheel: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check build
	$(BIN)/python -m build --outdir build/dist

clean:
	rm -rf build .pytest_cache .hypothesis .ruff_cache .mypy_cache

# Everything runs in a virtual environment of the checkout; `make catalog` and `make test` need nothing else.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
SAMPLE := sample_data/hadley_gld100_256ppd.tif
ALBEDO := sample_data/hadley_albedo_643nm_11ppd.tif
PHOTO := sample_data/AS15-M-0414
CATALOG := build/hadley.h5

unexport PYTHONDONTWRITEBYTECODE  # processes that start later need not compile the modules again

.DELETE_ON_ERROR:
.PHONY: all catalog gallery docs test test-slow check bench bench-build bench-merge bench-peers damage fuzz soak clean bench-moon bench-query bench-plan venv

all: catalog

venv: $(READY)

$(READY): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "lcp needs Python 3.11 or newer: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --upgrade 'pip>=25.1'
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable . --group dev
	touch $@

catalog: $(READY)
	@mkdir -p build
	$(BIN)/lcp build-catalog $(SAMPLE) -o $(CATALOG) --config sample_data/hadley.toml --overwrite
	$(BIN)/lcp report $(CATALOG) -o build/hadley.html --overwrite
	$(BIN)/lcp render $(SAMPLE) -o build/AS15-M-0414_render.tif --camera $(PHOTO)_camera.json --frame camera --gsd 474 \
	  --preview build/AS15-M-0414_render.png --overwrite
	$(BIN)/lcp render $(SAMPLE) -o build/hadley_relief.tif --center 3.5 26 --size 150 --sun-azimuth 96.5 --sun-elevation 13.7 \
	  --preview build/hadley_relief.png --overwrite
	$(BIN)/lcp inspect $(CATALOG)
	$(BIN)/lcp validate $(CATALOG) $(PHOTO).png --camera $(PHOTO)_camera.json --dem $(SAMPLE) --albedo $(ALBEDO) -o build/validation \
	  --known-pose --require 'points_found>=50 and share_above_0_9>=0.7' --overwrite
	@echo "catalogue  $(CATALOG)"
	@echo "report     build/hadley.html"
	@echo "validated  build/validation/report.html (the catalogue's points in the photograph, and the photograph beside renders)"
	@echo "previews   build/AS15-M-0414_render.png (beside $(PHOTO).png)  build/hadley_relief.png"

gallery: $(READY)
	@mkdir -p build
	$(BIN)/python docs/gallery.py build/gallery

docs: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --group docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "docs       build/site/index.html (its search needs a server: $(BIN)/python -m http.server -d build/site)"

test: $(READY)
	$(BIN)/python -m pytest -m 'not slow' -n auto --maxprocesses 4 --dist loadfile

test-slow: $(READY)
	$(BIN)/python -m pytest -m slow

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(READY)
	$(BIN)/python -m pytest benchmarks --benchmark-enable --benchmark-sort=name

bench-build: $(READY)
	$(BIN)/python benchmarks/build.py areas roofline memory jobs

damage: $(READY)
	PYTHONPATH=tests OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/damage.py

bench-moon: $(READY)
	$(BIN)/python benchmarks/moon.py plan maps areas

soak: $(READY)
	$(BIN)/python benchmarks/kills.py --kills 200
	$(BIN)/python benchmarks/faults.py

bench-query: $(READY)
	PYTHONPATH=tests OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/query.py

bench-merge: $(READY)
	PYTHONPATH=tests $(BIN)/python benchmarks/merge.py

bench-plan: $(READY)
	$(BIN)/python benchmarks/plan.py

bench-peers: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --group peers
	$(BIN)/python benchmarks/peers.py 2048 4096

fuzz: $(READY)
	$(BIN)/python benchmarks/fuzz.py

clean:
	rm -rf build .pytest_cache .hypothesis .ruff_cache .mypy_cache

# solmap: one command each. `make demo` and `make test` set up what they need.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
VIEWER := gis_server/viewer
STORE ?= .demo/store
DOWNLINK ?= .demo/downlink
PORT ?= 8765

# Small-block linear algebra is far slower with two BLAS threads than with one.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
export PREFECT_SERVER_ANALYTICS_ENABLED = false
export DO_NOT_TRACK = 1
# Compiled modules are kept, whatever the caller's environment says: tests start hundreds of processes.
export PYTHONDONTWRITEBYTECODE =

PIP_INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-compile
# On all processors; pip compiles on one.
COMPILE := $(BIN)/python -m compileall -q -j 0 $(VENV)/lib

.PHONY: setup kernels cluster develop viewer demo test test-all unit integration e2e test-viewer test-wheel check audit bench accuracy peers fuzz screenshots docs wheel clean

setup: $(VENV)/.installed  ## What a user needs.

$(VENV)/.installed: requirements.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) --requirement requirements.lock
	$(PIP_INSTALL) --editable .
	$(COMPILE)
	touch $@

kernels: $(VENV)/.kernels  ## Compiled loops over pixels; without them the first run compiles.

$(VENV)/.kernels: $(VENV)/.installed photogrammetry/compiled.py $(shell find photogrammetry -name kernels.py)
	$(BIN)/python -c "from solmap.photogrammetry.compiled import compile_all; compile_all()"
	touch $@

cluster: $(VENV)/.cluster  ## Also what PostgreSQL, an object store and Dask need.

$(VENV)/.cluster: $(VENV)/.installed requirements-cluster.lock
	$(PIP_INSTALL) --requirement requirements-cluster.lock
	$(COMPILE)
	touch $@

develop: $(VENV)/.develop  ## Also what tests, checks and documentation need.

$(VENV)/.develop: $(VENV)/.cluster requirements-dev.lock
	$(PIP_INSTALL) --requirement requirements-dev.lock
	$(COMPILE)
	touch $@

# npm is the machine's if it has one, else that of a Python package that carries Node.
HAVE_NPM := $(shell command -v npm)
NPM := $(if $(HAVE_NPM),npm,PATH="$(abspath $(BIN)):$$PATH" npm)
NPM_INSTALLED := $(if $(HAVE_NPM),,$(VENV)/.node-installed)

$(VENV)/.node-installed: requirements-node.lock $(VENV)/.installed
	$(PIP_INSTALL) --requirement requirements-node.lock
	$(COMPILE)
	touch $@

viewer: $(VIEWER)/dist/index.html

$(VIEWER)/dist/index.html: $(NPM_INSTALLED) $(shell find $(VIEWER)/src $(VIEWER)/index.html $(VIEWER)/package-lock.json $(VIEWER)/vite.config.ts 2>/dev/null)
	cd $(VIEWER) && $(NPM) ci --no-audit --no-fund --silent && $(NPM) run --silent build -- --logLevel error

demo:  ## A synthetic downlink through every stage to the map in the browser.
	@$(MAKE) --no-print-directory --jobs 2 setup viewer
	@$(MAKE) --no-print-directory kernels & compilation=$$!; { test -f $(DOWNLINK)/orbital/orbital.tif || \
	$(BIN)/solmap simulate $(DOWNLINK) --stops 2 --seed 1; } && wait $$compilation
	@mkdir -p $(STORE)/drafts  # an empty store: the map answers at once, and shows layers as they come
	@$(BIN)/solmap serve --store $(STORE) --port $(PORT) & trap "kill $$! 2> /dev/null" EXIT; \
	$(BIN)/solmap run $(DOWNLINK) --store $(STORE) && \
	$(BIN)/solmap orbital add $(DOWNLINK)/orbital/orbital.tif --no-control --store $(STORE) && \
	$(BIN)/solmap positions --store $(STORE) && \
	echo "the map is complete; Ctrl-C stops its server" && wait $$!

# `make test` tries the same examples each time; `make test-all` looks for more.
REPEATABLE := --hypothesis-profile=repeatable

# Two workers each with an engine, a database server and browsers of its own. The three suites run
# at once: where one waits, another uses the processor.
PARALLEL := --numprocesses 2 --dist loadfile
SUITES := unit integration e2e

test:  ## Everything that continuous integration asks for.
	@$(MAKE) --no-print-directory --jobs 2 develop viewer kernels
	@$(MAKE) --no-print-directory --jobs $(SUITES) check test-viewer PYTEST='-m "not slow" $(REPEATABLE)'

test-all: develop viewer kernels  ## Also what takes minutes: the rendered traverse, long simulations.
	@$(MAKE) --no-print-directory --jobs $(SUITES) check test-viewer

$(SUITES): develop viewer kernels  ## One of the suites of tests; PYTEST has further options.
	$(BIN)/pytest $(PARALLEL) $(PYTEST) tests/$@

test-viewer: viewer
	cd $(VIEWER) && $(NPM) run --silent check && $(NPM) test --silent

check: develop  ## Style, types and the direction of imports.
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

audit: develop  ## Known weaknesses of what is pinned; AUDIT=required fails where nobody can be asked.
	$(BIN)/python .ci/audit

# Without the checks of array types that every test runs under: they would be timed too.
bench: develop kernels  ## Times and ratios against a peer in the same run.
	$(BIN)/pytest -o addopts=--import-mode=importlib tests/benchmarks --benchmark-only --benchmark-disable-gc --benchmark-columns=min,median,rounds

ACCURACY ?=

accuracy: develop  ## Errors on rendered and simulated worlds, as .cache/accuracy/full/scorecard.md; ACCURACY="--level quick".
	$(BIN)/python -m tests.support.accuracy $(ACCURACY)

peers: develop  ## Rivals that `make bench` compares adjustment and tiles with; without them it skips.
	$(PIP_INSTALL) gtsam==4.3.0 pyceres==2.6 pycolmap==4.2.1 titiler.core==2.4.0 geojson-pydantic==2.2.0 simplejson==4.3.0

FUZZ_SECONDS ?= 30
FUZZ_TARGETS := label vicar image detached raster pds4 metadata camera picture vectors localisations names times ties

fuzz: develop  ## Every reader under mutated files; guided by coverage where atheris is installed.
	for target in $(FUZZ_TARGETS); do \
	  $(BIN)/python tests/fuzz/fuzz_readers.py $$target -max_total_time=$(FUZZ_SECONDS) \
	    -timeout=10 -rss_limit_mb=1500 -max_len=70000 || exit 1; \
	done

screenshots: develop viewer  ## The main tasks of the viewer at six widths, light and dark, in .cache/screenshots.
	$(BIN)/python -m tests.support.task_screenshots $(STORE) .cache/screenshots

docs: develop
	$(BIN)/mkdocs build --strict

wheel: develop viewer  ## dist/solmap-*.whl, the built viewer inside, and its bill of materials.
	rm -rf build dist
	$(BIN)/pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist .
	$(BIN)/python .ci/bill-of-materials dist/solmap-*.whl

test-wheel: wheel  ## The wheel in an empty environment: simulate, run, serve.
	$(BIN)/pytest tests/packaging

clean:
	rm -rf $(VENV) .demo build dist $(VIEWER)/dist $(VIEWER)/node_modules

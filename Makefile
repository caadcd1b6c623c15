# `make demo` and `make test` need nothing but Python >= 3.11 and make: each makes its own virtual environment.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# What one worker, notebook or command has compiled the others read.
COMPILED := JAX_COMPILATION_CACHE_DIR=$(CURDIR)/.cache/compiled JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0.2
# Half of the tests' time is compiling; the former emitters of the pinned jaxlib, one part a program and no optimisation take half of that.
# Programs that run often ask for level 1 themselves (processes.compiled_at).
QUICK_TO_COMPILE := XLA_FLAGS="--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1"
# Three test workers on two cores, for some tests wait for a browser, a cluster or a notebook; a second BLAS thread in each
# makes the Gaussian processes several times slower.
# One worker does what shares fixtures (tests/conftest.py); groups begin in the order in which they are collected.
PYTEST := $(COMPILED) $(QUICK_TO_COMPILE) OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n 3 --dist loadgroup --no-loadscope-reorder --durations=25
STAMP := $(VENV)/.installed

.PHONY: install demo picture test exact check verify fast docs notebooks clean

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.13")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt uv || true  # installs in a fifth of pip's time
	$(BIN)/uv pip install --quiet --python $(BIN)/python -c constraints.txt -e '.[test,docs]' || $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e '.[test,docs]'
	$(BIN)/python -m compileall -q -j 0 -x '/(tests?|testing|dialects|pip|setuptools|debugpy|statsmodels)/' $(VENV)/lib bayes_aero >/dev/null 2>&1 || true  # side by side; else the first command does it, in 10 s
	touch $(STAMP)

install: $(STAMP)  ## the environment alone, into .venv

demo: $(STAMP)  ## identify two simulated stalls (without the Gaussian processes: minutes, not a quarter of an hour); find a hidden effect
	$(BIN)/bayes-aero identify --no-gp --out demo
	$(BIN)/bayes-aero diagnose --no-trajectories --out demo/diagnosis

picture: $(STAMP)  ## the README's picture
	mkdir -p picture
	$(BIN)/bayes-aero simulate --effect thrust_moment=0.8 --noise buffet --seed 3 --force --out picture/stall_1.csv
	$(BIN)/bayes-aero simulate --effect thrust_moment=0.8 --noise buffet --seed 4 --force --out picture/stall_2.csv
	$(BIN)/bayes-aero diagnose picture/stall_1.csv picture/stall_2.csv --no-trajectories --no-test-points --out picture
	cp picture/figures/found.png notebooks/found.png

check: $(STAMP)  ## lint, types, layers
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	PYTHONPATH=. $(BIN)/lint-imports

fast: $(STAMP)  ## the tests without whole diagnoses of simulated flights and those on a cluster
	$(PYTEST) -m "not verify and not recovery and not cluster"

exact: $(STAMP)  ## every exact test
	$(PYTEST) -m "not verify"

test: $(STAMP)  ## lint, types, layers and every exact test, side by side
	$(MAKE) -j 2 check exact

verify: $(STAMP)  ## tests of rates, coverage and whole diagnoses; then fresh seeds against exact binomial bounds and a line of benchmarks/ledger.csv (VERIFY=--full: hours)
	$(PYTEST) -m verify
	$(COMPILED) $(QUICK_TO_COMPILE) OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python benchmarks/verify.py $(VERIFY)

docs: $(STAMP)  ## the documentation as a site, into ./site
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

notebooks: $(STAMP)  ## execute every notebook again (06 needs the ATTAS records in ../shared/attas)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python notebooks/run.py

clean:
	rm -rf $(VENV) demo picture build dist site .cache

# make demo   the main job on the embedded default, with its report
# make test   linter, type checker and tests      make test-all   the slow tests too
# make bench  speed, against peers in the same run and against tests/benchmarks/baseline.json
# make load    the service under load, on the loopback: latencies, lost rows, memory
# make notebooks, make pictures   run them again and store what they show
# make docs    the documentation site, into site/, strictly: a broken link or page is an error
# make claims  measure the results that README and docs show (hours)
# make results write the tables of README from the stored results; the site takes its own when it is built
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# Modules are turned into bytecode when they are imported, which few of those installed ever are.
# That is kept, whatever the caller's environment says: hundreds of tests begin a program of their own.
unexport PYTHONDONTWRITEBYTECODE
PIP := $(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt
# A worker a processor: each further one would import and collect all tests once more, on the same processors.
WORKERS := $(shell $(PYTHON) -c "import os; print(os.cpu_count() or 1)")
PYTEST := $(BIN)/python -m pytest --numprocesses $(WORKERS) --dist worksteal --durations 20 --durations-min 5
.PHONY: demo docs load test lint compiled-solver compiled-others checked test-all bench notebooks pictures claims results clean
.DELETE_ON_ERROR:

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) --editable .
	@touch $@

$(VENV)/installed-test: $(VENV)/installed
	$(PIP) --editable '.[test]'
	# For comparisons. Both ask for opencv-python, which would overwrite opencv-python-headless; all else is there.
	$(PIP) --no-deps trackers trackeval
	@touch $@

demo: $(VENV)/installed
	$(BIN)/graphtrack demo --out demo

lint: $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# What the tests run is compiled once for all of their workers, beside what else takes long: the solver while
# the tests' own packages are installed, the others beside the type checker.
compiled-solver: $(VENV)/installed
compiled-others: $(VENV)/installed-test
compiled-solver compiled-others: compiled-%:
	$(BIN)/python tests/support/compile_first.py $*

checked: $(VENV)/installed
	$(MAKE) --jobs=2 --output-sync=target compiled-solver lint compiled-others

test: checked
	$(PYTEST)

test-all: export HYPOTHESIS_PROFILE ?= nightly
test-all: export GRAPHTRACK_FUZZ_SEED ?= $(shell date +%Y%m%d)
test-all: checked
	$(PYTEST) -m 'not benchmark'

bench: $(VENV)/installed-test
	$(BIN)/python -m pytest tests/benchmarks -m benchmark

notebooks: $(VENV)/installed-test
	$(BIN)/python notebooks/execute.py

load: $(VENV)/installed-test
	$(BIN)/python tests/load/load.py

docs: $(VENV)/installed-test
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --site-dir site

pictures: $(VENV)/installed
	$(BIN)/python docs/pictures.py

# Hours: the experiments at full size, stored in docs/results/data, which the site shows.
claims: $(VENV)/installed-test
	$(BIN)/python docs/hooks/results.py --measure

results: $(VENV)/installed-test
	$(BIN)/python docs/hooks/results.py

clean:
	rm -rf $(VENV) demo build .pytest_cache .mypy_cache .ruff_cache .hypothesis

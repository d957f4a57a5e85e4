# make demo   the main job on the embedded default, with its report
# make test   linter, type checker and tests      make test-all   the slow tests too
# make bench  speed, against peers in the same run and against tests/benchmarks/baseline.json
# make notebooks, make pictures   run them again and store what they show
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
.PHONY: demo test lint test-all bench notebooks pictures clean
.DELETE_ON_ERROR:

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	@touch $@

$(VENV)/installed-test: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[test]'
	@touch $@

demo: $(VENV)/installed
	$(BIN)/graphtrack demo --out demo

lint: $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: lint
	$(BIN)/python -m pytest -n auto

test-all: lint
	$(BIN)/python -m pytest -n auto -m 'not benchmark'

bench: $(VENV)/installed-test
	$(BIN)/python -m pytest tests/benchmarks -m benchmark

notebooks: $(VENV)/installed-test
	$(BIN)/python notebooks/execute.py

pictures: demo
	mkdir -p docs/images
	cp demo/tracks.png docs/images/demo.png

clean:
	rm -rf $(VENV) demo build .pytest_cache .mypy_cache .ruff_cache .hypothesis

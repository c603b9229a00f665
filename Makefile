# make demo   set up what the demo needs, then tune, compare and report in one go
# make test   set up everything, then run the tests
# make setup  only set up: .venv with everything, kernels compiled; quick when there is nothing to do
# make docs   build the documentation site: build/docs/index.html
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
PIP := $(RUN) -m pip install --disable-pip-version-check --constraint constraints.txt
WORKERS ?= 2

.PHONY: demo test test-slow lint types docs wheel setup clean

demo: $(VENV)/tuning
	$(RUN) -m navgym.command warm auv
	$(RUN) -m navgym.command demo

test: setup
	$(RUN) -m pytest -n $(WORKERS) -m "not slow"

test-slow: setup
	$(RUN) -m pytest -n $(WORKERS) -m slow

lint: types
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

# The type checker reads an installed copy: it does not follow an editable install's mapping of
# navgym.agents and navgym.tuning to the folders of those names.
types: $(VENV)/everything
	rm -rf build/lib build/typed
	$(PIP) --quiet --no-deps --target build/typed .
	cd build/typed && ../../$(VENV)/bin/mypy --config-file ../../pyproject.toml --cache-dir ../mypy

docs: $(VENV)/everything
	$(VENV)/bin/sphinx-build -W --keep-going -b html docs build/docs

wheel: $(VENV)/tuning
	rm -rf build/lib dist
	$(RUN) -m pip wheel --disable-pip-version-check --no-deps --wheel-dir dist .

setup: $(VENV)/everything
	@$(RUN) -m navgym.command warm

$(VENV)/python:
	$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "navgym needs Python 3.11 or newer: make PYTHON=python3.11"'
	test -x $(RUN) || $(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/tuning: pyproject.toml constraints.txt | $(VENV)/python
	$(PIP) --editable ".[tuning]"
	touch $@

$(VENV)/everything: pyproject.toml constraints.txt | $(VENV)/python
	$(PIP) torch
	$(PIP) --editable ".[tuning,agents,render,cluster,docs,dev]"
	touch $@ $(VENV)/tuning

clean:
	rm -rf $(VENV) runs build dist *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# make demo   set up, then tune, compare and report in one go
# make test   set up, then run the tests
# make setup  only set up: .venv with everything, kernels compiled; quick when there is nothing to do
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python
WORKERS ?= 2

.PHONY: demo test test-slow lint setup clean

demo: setup
	$(RUN) scripts/demo.py

test: setup
	$(RUN) -m pytest -n $(WORKERS) -m "not slow"

test-slow: setup
	$(RUN) -m pytest -n $(WORKERS) -m slow

lint: setup
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

setup: $(VENV)/installed
	@$(RUN) -m navgym.warm

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "navgym needs Python 3.11 or newer: make PYTHON=python3.11"'
	test -x $(RUN) || $(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --disable-pip-version-check --constraint constraints.txt torch
	$(RUN) -m pip install --disable-pip-version-check --constraint constraints.txt --editable ".[tuning,agents,render,cluster,dev]"
	touch $@

clean:
	rm -rf $(VENV) runs build *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

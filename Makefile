# Two commands matter: `make run` serves the demo machine, `make test` proves the tree. `make help` lists the rest.
PYTHON ?= python3
HOST ?= 127.0.0.1
PORT ?= 8000
SERVE_VENV := .venv
DEV_VENV := .venv-test
CHECK_PYTHON_LINE = $(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { echo "thermotrue needs Python 3.11 or newer, got $$($(PYTHON) --version 2>/dev/null || echo "no '$(PYTHON)'"); name another: make PYTHON=python3.12"; exit 1; }
PIP_FLAGS := --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: help run test bundle warm lint types imports unit format clean

help:  ## list the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /  make \1\t/'

run: $(SERVE_VENV)/.installed  ## serve the demo machine on http://127.0.0.1:8000
	@$(SERVE_VENV)/bin/thermotrue serve demo/vmc3 --replay --host $(HOST) --port $(PORT)

warm: $(SERVE_VENV)/.installed  ## post an hour of telemetry to the running demo and watch the correction follow
	@$(SERVE_VENV)/bin/python demo/warm_up.py --port $(PORT)

test: lint types imports unit  ## lint, types, import contracts, tests

lint: $(DEV_VENV)/.installed
	$(DEV_VENV)/bin/ruff check .
	$(DEV_VENV)/bin/ruff format --check .

types: $(DEV_VENV)/.installed
	$(DEV_VENV)/bin/mypy

imports: $(DEV_VENV)/.installed
	$(DEV_VENV)/bin/lint-imports

unit: $(DEV_VENV)/.installed
	$(DEV_VENV)/bin/python -m pytest

format: $(DEV_VENV)/.installed  ## put the code into its form
	$(DEV_VENV)/bin/ruff format .
	$(DEV_VENV)/bin/ruff check --fix .

bundle: $(DEV_VENV)/.installed  ## make demo/vmc3 and the README's picture again, from seeds and code
	$(DEV_VENV)/bin/python demo/make_demo.py

clean:  ## remove what the targets made
	rm -rf $(SERVE_VENV) $(DEV_VENV) out .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

# The service alone: no torch, no SciPy.
$(SERVE_VENV)/.installed: pyproject.toml constraints.txt
	@$(CHECK_PYTHON_LINE)
	@echo "installing the service into $(SERVE_VENV) (once, about half a minute)"
	@$(PYTHON) -m venv $(SERVE_VENV)
	@$(SERVE_VENV)/bin/python -m pip install $(PIP_FLAGS) --editable .
	@$(SERVE_VENV)/bin/python -c 'import model.kernel'  # compiled and kept now, so that no start waits for it
	@touch $@

$(DEV_VENV)/.installed: pyproject.toml constraints.txt
	@$(CHECK_PYTHON_LINE)
	@echo "installing everything, torch included, into $(DEV_VENV) (once, a few minutes)"
	@$(PYTHON) -m venv $(DEV_VENV)
	@$(DEV_VENV)/bin/python -m pip install $(PIP_FLAGS) --editable '.[train,dev]'
	@$(DEV_VENV)/bin/python -c 'import model.kernel'
	@touch $@

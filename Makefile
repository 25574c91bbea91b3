# make demo: simulate a finger, reconstruct it, compare it with the truth, write ./demo/
# make test: lint, types, import rules, tests
# make examples: run every example and write docs/examples.md
# make clean: remove what these made

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# two processes; PYTEST_ARGS="-n 0 -k name" for one
PYTEST_ARGS ?= -n 2

# Both names: pip reads the first for everything it installs (older pip for build tools too), the second for build tools.
export PIP_CONSTRAINT := $(CURDIR)/constraints.txt
export PIP_BUILD_CONSTRAINT := $(CURDIR)/constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: demo test examples clean

demo: $(VENV)/.ready
	$(BIN)/splitknit demo --out demo

test: $(VENV)/.ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest $(PYTEST_ARGS)

examples: $(VENV)/.ready
	$(BIN)/python tools/build_examples.py

$(VENV)/.ready: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "splitknit needs Python 3.11 or later: make PYTHON=python3.11 ...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[batch,minutiae]'
	@touch $@

$(VENV)/.ready-dev: $(VENV)/.ready
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[dev]'
	@touch $@

clean:
	rm -rf $(VENV) demo .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache .benchmarks
	find src tests examples benchmarks validation -name __pycache__ -type d -prune -exec rm -rf {} +

# make demo: simulate a finger, reconstruct it, compare it with the truth, write ./demo/
# make test: lint, types, import rules, tests of all members
# make test MEMBER=splitknit: one member's tests, in an environment with only that member and what it may import
# make examples: run every example and write docs/guide/examples.md
# make docs: the documentation as a site, ./site/index.html; a broken link or an undocumented public name is an error
# make install: all that `splitknit` needs; with EXTRAS=photos (docs/guide/install.md) other parts as well
# make lock: write constraints.txt for the dependencies of all members; with LOCK_ARGS=--upgrade in newer releases
# make clean: remove what these made

PYTHON ?= python3
VENV := .venv
BIN = $(VENV)/bin
# two processes, each of which keeps to its own files while it has any; PYTEST_ARGS="-n 0 -k name" for one
PYTEST_ARGS ?= -n 2 --dist worksteal

MEMBERS := splitknit splitknit-simulator splitknit-rig splitknit-match
EXTRAS ?= minutiae
LOCK_ARGS ?=

# the member of each extra
$(eval OF_photos := splitknit[photos])
$(eval OF_capture := splitknit-rig[capture])
$(foreach name,cluster encrypt mesh minutiae plot records serve,$(eval OF_$(name) := splitknit-match[$(name)]))
comma := ,
wanted := $(subst $(comma), ,$(EXTRAS))

# Every file that is installed must have a hash of constraints.txt, build tools (PIP_BUILD_CONSTRAINT) too.
INSTALL = $(BIN)/python -m pip install --quiet --require-hashes -c constraints.txt
pinned = sed -n '/^$(1)==/,/[^\\]$$/p' constraints.txt
export PIP_BUILD_CONSTRAINT := $(CURDIR)/constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: demo test types tests examples docs install lock clean

ifdef MEMBER
# an environment of its own: what the member may import, and no more
member := $(subst _,-,$(MEMBER))
needs := $(if $(filter $(member),$(MEMBERS)),,$(error no member '$(MEMBER)'; there are $(MEMBERS)))
# what their tests need beside the core: the simulator
needs := splitknit $(if $(filter splitknit,$(member)),,splitknit-simulator $(member))
MEMBERS := $(sort $(needs))
VENV := .venv-$(member)

test: $(VENV)/.ready-dev
	OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest $(PYTEST_ARGS) packages/$(member)/tests

$(VENV)/.ready-dev: $(VENV)/.ready
	$(INSTALL) --group test-$(member)
	@touch $@
else
demo: $(VENV)/.ready
	$(BIN)/splitknit demo --out demo

test: $(VENV)/.ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(MAKE) --no-print-directory --jobs 2 types tests

$(VENV)/.ready-dev: $(VENV)/.ready
	$(INSTALL) --group dev
	@touch $@
endif

# mypy takes one core for most of a minute, so the tests run beside it
types:
	$(BIN)/mypy

# one thread of OpenBLAS, as the command line has it: processes times threads would wait for each other; the many processes
# that tests start read modules compiled once, also where the environment asks not to write these
tests:
	OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest $(PYTEST_ARGS)

examples: $(VENV)/.ready
	$(BIN)/python tools/build_examples.py

docs: $(VENV)/.ready
	$(INSTALL) --group docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

install: $(VENV)/.ready
	$(INSTALL) $(foreach name,$(wanted),'$(or $(OF_$(name)),$(error no extra '$(name)'))')

# The pip of Python 3.11 does not take hashes from constraints, so a newer one is installed first, and the setuptools
# that comes with it (65.5.0, with known vulnerabilities) goes. The members are folders, which have no hash; then
# they are there, and pip only adds what they need. Where Debian lacks python3-venv half of an environment is left, which
# the next `make` must not take for a whole one.
$(VENV)/.ready: constraints.txt $(MEMBERS:%=packages/%/pyproject.toml)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "splitknit needs Python 3.11 or later: make PYTHON=python3.11 ...")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || { rm -f $(BIN)/python; exit 1; }
	$(call pinned,pip) > $(VENV)/pip.txt
	$(BIN)/python -m pip install --quiet --require-hashes -r $(VENV)/pip.txt
	$(BIN)/python -m pip uninstall --quiet --quiet --yes setuptools
	$(BIN)/python -m pip install --quiet --no-deps $(MEMBERS:%=-e packages/%)
	$(INSTALL) $(MEMBERS) $(if $(filter splitknit-match,$(MEMBERS)),'splitknit-match[minutiae]')
	@touch $@

# Hashes are those of all files of a release, for every platform, and those that are there already: torch's first one is
# of its CPU build for x86-64 Linux, which is offered elsewhere; `pip hash FILE` gives the one of another release.
lock:
	$(PYTHON) -m venv $(VENV)/lock
	$(call pinned,uv) > $(VENV)/lock/uv.txt
	$(VENV)/lock/bin/python -m pip install --quiet --require-hashes -r $(VENV)/lock/uv.txt
	$(VENV)/lock/bin/uv pip compile --quiet --universal --generate-hashes --no-annotate --custom-compile-command 'make lock' \
		--python-version 3.11 $(foreach name,capture,) \
		$(foreach name,mesh photos plot cluster encrypt minutiae records serve,--extra $(name)) \
		--group dev --group browser --group docs --group hardware --group install --group reference --group training \
		$(MEMBERS:%=--no-emit-package %) \
		$(LOCK_ARGS) --output-file constraints.txt $(MEMBERS:%=packages/%/pyproject.toml)

clean:
	rm -rf .venv .venv-* demo site .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache .benchmarks
	find packages tests examples benchmarks training validation -name __pycache__ -type d -prune -exec rm -rf {} +

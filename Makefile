# Everything below sets up .venv first: make and Python 3.11 to 3.14 are all it needs.
EXPLICIT_PYTHON := $(if $(filter-out undefined,$(origin PYTHON)),--explicit-python)
SUPPORTED := -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' 2>/dev/null
ifndef PYTHON
PYTHON := $(shell for python in python3 python3.14 python3.13 python3.12 python3.11; do \
	$$python $(SUPPORTED) && echo $$python && break; done)
endif
VENV := .venv
BIN := $(VENV)/bin
SHELL := /bin/bash

WORKERS ?= $(shell $(PYTHON) -c 'import os; print(os.cpu_count() or 2)')

# Each process would compile all modules anew.
unexport PYTHONDONTWRITEBYTECODE
# No display is needed or looked for; set MUJOCO_GL yourself to render.
export MUJOCO_GL ?= disable

.PHONY: help supported runnable setup demo docs check test test-all test-slow test-long lint smoke wheels dist bench faults pictures soak fuzz clean

help:
	@echo "make demo   a hexapod loses a leg in mid-walk and recovers, in simulation"
	@echo "make check  style, types and the quick tests of what changed (half a minute)"
	@echo "make test   style, types and tests (2 minutes on two cores)"
	@echo "make test-all  everything: whole commands, studies, every page, and what runs in real time (half an hour)"
	@echo "make smoke  the built wheel, installed alone; then with the simulation, as its error says"
	@echo "make wheels  every package has a wheel for each supported Python, on x86-64 and arm64"
	@echo "make dist   wheel and sdist, checked and installed in an empty environment"
	@echo "make bench  the numbers hexctl promises, measured (three hours, most of them on simulated buses and over a link)"
	@echo "make faults  what is missing of the fault matrix (hours; Ctrl-C ends it)"
	@echo "make pictures  the pictures of the documentation, made anew (a few minutes)"
	@echo "make soak   the long tests: a hundred stops, hostile input without end"
	@echo "make fuzz   every decoder under mutated inputs led by coverage; SECONDS=5 or INPUTS=1000 for less of each"
	@echo "make docs   the documentation as a site, in build/site"
	@echo "make clean  remove what the others made, recordings excepted"

supported:
	@$(or $(PYTHON),false) $(SUPPORTED) || { echo "hexctl needs Python 3.11 to 3.14 (got $(or $(PYTHON),none \
	on the path)); name one: make $(MAKECMDGOALS) PYTHON=/path/to/python3.13" >&2; exit 1; }

# What hexctl needs to walk and to show it; and with the tools of development on top.
environment = $(PYTHON) environment.py $(EXPLICIT_PYTHON) "$(VENV)"
runnable: supported
	@$(environment) demo

setup: supported
	@$(environment) all dev

# Two of them at a time would spoil one another.
.NOTPARALLEL:

demo: runnable
	$(BIN)/hexctl demo

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Tests of a lane, by its marks ($2), in so many processes ($1). A test that hangs is ended with the stacks of all
# threads.
PYTEST := $(BIN)/pytest -o faulthandler_timeout=300 -o faulthandler_exit_on_timeout=true
lane = $(PYTEST) -n $1 -m "$2 and not soak"

# A command with style and types beside it, which are printed after it; both must pass.
define linted
	@mkdir -p build; $(MAKE) --no-print-directory lint >build/lint.txt 2>&1 & lint=$$!; \
	trap 'kill $$lint 2>/dev/null' EXIT; \
	$1; tests=$$?; wait $$lint; style=$$?; trap - EXIT; cat build/lint.txt; exit $$((tests | style))
endef

# Since main, or since the last commit on main itself.
check: setup
	$(call linted,$(BIN)/python -m tests.changed)

test: setup
	$(call linted,$(call lane,$(WORKERS),not realtime and not slow and not long))

# Everything, and four times the examples of each property.
test-all: export HYPOTHESIS_PROFILE = thorough
test-all: test test-slow test-long

# Tests that compute fill the cores. Tests that keep time come afterwards, four at a time: they mostly wait. A
# browser without a graphics card fills a core, so those come one at a time.
realtime_lane = $(call lane,4,realtime and not long) --ignore tests/browser
browser_lane = $(call lane,0,realtime and not long) tests/browser

test-slow: setup
	$(call lane,$(WORKERS),slow and not realtime and not long)
	$(realtime_lane)
	$(browser_lane)

test-long: setup
	$(call lane,$(WORKERS),long and not realtime)
	$(call lane,$(WORKERS),long and realtime)

# The built wheel, alone in a fresh environment: what a robot's own computer gets. Needs nothing of .venv.
SMOKE := build/smoke
SMOKE_PIP := $(SMOKE)/venv/bin/python -m pip --quiet --disable-pip-version-check
smoke: supported
	rm -rf $(SMOKE)
	$(PYTHON) -m venv $(SMOKE)/venv
	cp constraints.txt $(SMOKE)
	$(SMOKE_PIP) wheel --no-deps -w $(SMOKE) .
	$(SMOKE_PIP) install --no-compile -c constraints.txt $(SMOKE)/*.whl
	cd $(SMOKE) && venv/bin/hexctl check pexod && venv/bin/hexctl run --backend mock --no-record --duration 0.2
	cd $(SMOKE) && PIP_CONSTRAINT=constraints.txt venv/bin/python ../../tests/smoke.py venv/bin/hexctl
	cd $(SMOKE) && rm -r venv/lib/python*/site-packages/hexctl/{study,vision,simulators,testing} && \
	venv/bin/hexctl --help && venv/bin/hexctl run --backend mock --no-record --duration 0.2

# Resolves for Pythons and processors that this computer need not have; installs nothing but uv. Debian 12 has 3.11.2.
wheels: supported
	rm -rf build/wheels
	$(PYTHON) -m venv build/wheels
	build/wheels/bin/python -m pip install --quiet --disable-pip-version-check "uv>=0.9,<1"
	@for version in 3.11.2 3.12 3.13 3.14; do for processor in x86_64 aarch64; do \
		build/wheels/bin/uv pip compile --quiet --extra all --extra dev -c constraints.txt --only-binary :all: \
		--python-version $$version --python-platform $$processor-manylinux_2_31 -o /dev/null pyproject.toml || exit 1; \
		echo "wheels for Python $$version on $$processor: all"; \
	done; done

# Wheel and sdist in dist/, checked by twine, and each installed in an empty environment; the tools that build
# them have an environment of their own.
dist: supported
	@grep -q '^Repository = "http' pyproject.toml || echo "before you publish: set project.urls.Repository in pyproject.toml"
	rm -rf dist build/dist
	$(PYTHON) -m venv build/dist/tools
	build/dist/tools/bin/python -m pip install --quiet --disable-pip-version-check "build>=1.2,<2" "twine>=6,<7"
	build/dist/tools/bin/python -m build --outdir dist .
	build/dist/tools/bin/python -m twine check --strict dist/*
	for file in dist/*; do \
		rm -rf build/dist/empty && $(PYTHON) -m venv build/dist/empty && \
		build/dist/empty/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt $$file && \
		(cd build/dist && empty/bin/hexctl check pexod && \
		empty/bin/hexctl run --backend mock --no-record --duration 0.2) || exit 1; \
	done

bench: setup
	$(BIN)/python -m benchmarks

# Adds to faults/injections.jsonl; tables and figure of docs/results/fault-matrix.md are made from it.
REPETITIONS ?= 3
faults: setup
	$(BIN)/python -m faults --repetitions $(REPETITIONS)

# Needs a screen that nobody sees, and says which packages that takes.
pictures: setup
	$(BIN)/python -m pictures

soak: setup
	$(BIN)/pytest -m soak

# Whichever of both is over first ends a decoder; all of them take up to 80 minutes.
INPUTS ?= 1000000
SECONDS ?= 60
fuzz: setup
	@$(environment) fuzz
	$(BIN)/python -m tests.fuzz --inputs $(INPUTS) --seconds $(SECONDS)

docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

clean:
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis

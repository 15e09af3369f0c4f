# Everything below sets up .venv first: Python >= 3.11 and make are all it needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed

# No display is needed or looked for; set MUJOCO_GL yourself to render.
export MUJOCO_GL ?= disable

.PHONY: help setup demo test lint bench clean

help:
	@echo "make demo   walk a hexapod with a failed leg in simulation, and say how to look at it"
	@echo "make test   style, types and tests"
	@echo "make bench  the numbers hexctl promises, measured (about 15 minutes)"
	@echo "make clean  remove what the others made, recordings excepted"

setup: $(INSTALLED)

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[all,dev]"
	touch $@

demo: $(INSTALLED)
	$(BIN)/hexctl run --failed-leg 5

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: lint
	$(BIN)/pytest -n auto

bench: $(INSTALLED)
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis

# `make demo` runs the main job on a motion made from nothing; `make test` runs the tests. Both need only Python and make.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: install demo test lint types check benchmark clean

install: .venv/installed

.venv/installed: pyproject.toml
	$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(v < (3, 11) and f"motionrecover needs Python 3.11 or newer, found {v[0]}.{v[1]}: make PYTHON=python3.12")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --editable . --group dev
	touch $@

demo: install
	$(BIN)/motionrecover demo --output demo --overwrite

test: install
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: install
	$(BIN)/pyright

check: lint types test

clean:
	rm -rf .venv demo build dist *.egg-info

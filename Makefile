# `make demo` runs the main job on a motion made from nothing; `make test` runs the tests. Both need only Python and make.
PYTHON ?= python3
CLIENTS_PYTHON ?= python3.11
BIN := .venv/bin

.PHONY: install demo test clients lint types check benchmark clean

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

# What we write, in the programs it is for, each in an environment of its own: bpy and opensim have wheels for single
# versions of Python, these for 3.11. 2.4 GB.
clients: install .venv-blender-4.2/installed .venv-blender-5.0/installed .venv-opensim/installed
	$(BIN)/python -m pytest -m clients tests/clients

.venv-blender-%/installed:
	$(CLIENTS_PYTHON) -m venv $(@D)
	$(@D)/bin/python -m pip install --quiet "bpy~=$*.0" "numpy<2"
	touch $@

.venv-opensim/installed:
	$(CLIENTS_PYTHON) -m venv $(@D)
	$(@D)/bin/python -m pip install --quiet "opensim>=4.6"
	touch $@

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: install
	$(BIN)/pyright

check: lint types test

clean:
	rm -rf .venv .venv-* demo build dist *.egg-info

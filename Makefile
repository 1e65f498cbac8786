# `make demo` plays a tournament, `make test` runs the tests. Both install their requirements into .venv on the first call.

PYTHON ?= python3
VENV ?= .venv
# Matches per pair of policies in `make demo`.
MATCHES ?= 20
# Additional package index, for example one with CPU builds of PyTorch; see CONTRIBUTING.md.
TORCH_INDEX ?=
# Additional flags of pytest, for example '-k league'.
PYTEST_FLAGS ?=
# What `make reproduce` makes again: a table by name, or a part of all such as '--part 1/8'.
TABLE ?=
# Number of test processes; 0: run all tests in one process.
JOBS ?= auto

export PIP_CONSTRAINT := constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Images of containers often set it; hundreds of processes of the tests would compile the package again.
export PYTHONDONTWRITEBYTECODE :=

BIN := $(VENV)/bin
# On a terminal pip shows what it downloads, which takes minutes.
INSTALL := $(BIN)/python -m pip install $(if $(MAKE_TERMOUT),,-qq) $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX))
PYTEST := $(BIN)/python -m pytest -n $(JOBS) --maxprocesses 4 --dist worksteal --durations 10 -rfER
# A stamp marks a finished installation. The larger installation includes the smaller one.
RUN_STAMP := $(VENV)/.installed-run
TEST_STAMP := $(VENV)/.installed-test
INPUTS := pyproject.toml constraints.txt

# `-t quick` leaves out the reference.
SITE_FLAGS ?=

PAGE := shuttle_marl/court/page

.PHONY: help demo test test-slow install lint format docs notebooks dist reproduce lock clean
.NOTPARALLEL:

help:
	@echo 'make demo       play a tournament between the players of the package, into runs/demo'
	@echo 'make test       run all tests except the slow ones: a few minutes'
	@echo 'make test-slow  run the slow tests: training runs, killed processes, tutorials, Ray and Node'
	@echo 'make install    install all requirements, including PyTorch'
	@echo 'make lint       check format, style, types and layers'
	@echo 'make format     format the code and apply automatic fixes'
	@echo 'make docs       build the site of the documentation, into build/site'
	@echo 'make notebooks  execute the tutorials as notebooks, which `make docs` then shows: minutes'
	@echo 'make dist       build the wheel and the source distribution, into dist'
	@echo 'make reproduce  list the tables of the documentation; TABLE=name makes one again and compares, TABLE="--part 1/8" a part of all'
	@echo 'make lock       resolve all versions again and write them to constraints.txt'
	@echo 'make clean      remove .venv and caches'

demo: $(RUN_STAMP)
	$(BIN)/python -m shuttle_marl.league --matches $(MATCHES) --out runs/demo --overwrite

test: $(TEST_STAMP)
	$(PYTEST) -m 'not slow' $(PYTEST_FLAGS)

test-slow: $(TEST_STAMP)
	$(PYTEST) -m slow $(PYTEST_FLAGS)

install: $(TEST_STAMP)

lint: $(TEST_STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo --no-cache
	$(BIN)/python -m docs.tools.wire_types --check
	cd $(PAGE) && npm ci --silent --no-audit --no-fund --ignore-scripts && node_modules/.bin/biome check . && node_modules/.bin/tsc -p .

format: $(TEST_STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	cd $(PAGE) && npm ci --silent --no-audit --no-fund --ignore-scripts && node_modules/.bin/biome check --write .

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo 'Python 3.11 or later is required; `make PYTHON=python3.11 …` selects another interpreter'; exit 1; }
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 1; }

$(RUN_STAMP): $(INPUTS) | $(BIN)/python
	@echo 'Installing into $(VENV) (first call only) …'
	@$(INSTALL) --editable .
	@touch $@

$(TEST_STAMP): $(INPUTS) | $(BIN)/python
	@echo 'Installing into $(VENV), with PyTorch and the development tools (first call only) …'
	@$(INSTALL) --editable '.[test]'
	@touch $(RUN_STAMP) $@

# Warnings are errors. First comes a match, which plays in frames of the site.
docs: $(TEST_STAMP)
	$(BIN)/python -m shuttle_marl.watch --save-site docs/site/extra/live
	$(BIN)/python -m sphinx -W --keep-going -q $(SITE_FLAGS) -j 2 -d build/doctrees -c docs/site . build/site
	@echo 'python -m http.server -d build/site shows it'

notebooks: $(TEST_STAMP)
	@$(INSTALL) --editable '.[notebooks]'
	$(BIN)/python -m docs.tools.notebooks

dist: $(RUN_STAMP)
	rm -rf dist
	@$(INSTALL) build twine check-wheel-contents
	SHUTTLE_MARL_PAGE=1 $(BIN)/python -m build --quiet
	$(BIN)/twine check --strict dist/*
	$(BIN)/check-wheel-contents dist/*.whl

reproduce: $(TEST_STAMP)
	$(BIN)/python -m docs.tools.reproduce $(TABLE)

# Versions are resolved in a separate environment. The local part of a version (`+cpu`) is removed, so that a pin is valid on
# every platform.
lock: export PIP_CONSTRAINT :=
lock:
	@folder=$$(mktemp -d) && trap 'rm -rf "$$folder"' EXIT \
		&& $(PYTHON) -m venv "$$folder" \
		&& "$$folder/bin/python" -m pip install -qq 'torch$(shell sed -n 's/^torch\(==[^+]*\)$$/\1/p' constraints.txt)' . '.[test,notebooks]' editables build twine check-wheel-contents \
		&& "$$folder/bin/python" -m pip freeze --all --exclude pip --exclude shuttle-marl \
		| sed 's/+cpu$$//' | { sed -n '/^#/p' constraints.txt; cat; } > constraints.txt.part \
		&& mv constraints.txt.part constraints.txt

clean:
	rm -rf $(VENV) build dist docs/notebooks docs/reference docs/site/extra/live .mypy_cache .pytest_cache .ruff_cache .hypothesis

# make demo: simulate a building, map it, draw it.    make test: the whole suite, in minutes.
# Both set up a virtual environment of their own first; nothing else is needed but Python 3.11+, venv and make.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
# Worker processes of the suite; a worker that runs out of tests takes over some of another's.
WORKERS ?= auto
PYTEST := $(BIN)/python -m pytest --numprocesses $(WORKERS) --dist worksteal
# The tests that are worth running without the compiler.
PLAIN := tests/lattice tests/maps tests/graph tests/planners/test_planners.py tests/planners/test_canonical.py tests/planners/test_replanning.py

.PHONY: demo test test-all test-nojit contracts lint bench clean

demo: $(READY)
	$(BIN)/hexmap demo --output demo

test: contracts test-nojit
	$(PYTEST)

# The long sweeps as well, and more examples of everything. What passes `make test` may fail here, never the reverse.
test-all: contracts
	NUMBA_DISABLE_JIT=1 $(PYTEST) --long $(PLAIN)
	$(PYTEST) --long

# The kernels as plain Python: bounds are checked, and what the compiler might hide shows.
test-nojit: $(READY)
	NUMBA_DISABLE_JIT=1 $(PYTEST) $(PLAIN)

# Which folder may import which.
contracts: $(READY)
	$(BIN)/lint-imports

lint: $(READY)
	$(BIN)/ruff check
	$(BIN)/mypy

bench: $(READY)
	$(BIN)/python -m pip install --quiet --editable ".[bench]"
	$(BIN)/python -m tests.benchmarks

$(READY): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "hexmap needs Python 3.11 or newer (make PYTHON=python3.12 ...)")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --config-settings editable_mode=compat --editable ".[test]"
	touch $(READY)

clean:
	rm -rf $(VENV) .kernels demo build *.egg-info
	find hexmap planners localisation tests -name __pycache__ -exec rm -rf {} +

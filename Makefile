# Each target sets up what it needs first. `make` alone lists them.

.DEFAULT_GOAL := help
.PHONY: help serve setup test check bench clean

ARGS ?=
JOBS ?= 2
PYTHON ?=
export PYTHON
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1# it would ask the network for a newer version

help:  ## List the targets
	@sed -nE 's/^([a-z]+):.*## (.*)/make \1\t\2/p' Makefile | expand -t 14

serve:  ## Open the inspector on the demo, or on your data: make serve ARGS="../data/lmo --results x.csv"
	@scripts/setup.sh serve
	@.venv/bin/inspector serve $(ARGS)

setup:  ## Set up all that tests and development need: .venv, system libraries, Chromium
	@scripts/setup.sh test

test: setup  ## Run the tests; some of them only: make test ARGS="tests/pipeline -k pose"
	.venv/bin/pytest -n $(JOBS) --dist loadfile $(ARGS)

check: setup  ## Look for faults without running: lint, format, types, layers
	.venv/bin/ruff check
	.venv/bin/ruff format --check
	.venv/bin/pyright
	.venv/bin/pytest -q tests/test_layering.py

bench: setup  ## Run the benchmarks, one after the other
	@failed=; for script in benchmarks/*.py; do \
		echo "== $$script"; .venv/bin/python $$script || failed="$$failed $$script"; \
	done; test -z "$$failed" || { echo "failed:$$failed"; exit 1; }

clean:  ## Remove .venv and all that is made again when needed
	rm -rf .venv build dist *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Everything a newcomer needs: `make demo`, `make test`. Each target sets up .venv first, once.
ARGS ?=
# The first interpreter on PATH from 3.11 to 3.13 that can really make an environment.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null \
	&& { echo $$p; break; }; done)
BIN := .venv/bin
READY := .venv/.ready
PEERS := .venv/.peers
COMPILE := uv pip compile pyproject.toml --universal --generate-hashes --python-version 3.11 --no-header --no-annotate

.PHONY: setup demo test bench lint long lock clean
.DEFAULT_GOAL := setup

setup: $(READY)

$(READY): requirements.lock pyproject.toml
	@test -n "$(PYTHON)" || { echo "inertrim needs Python 3.11, 3.12 or 3.13 with venv on PATH (Debian: apt install python3-venv), or: make PYTHON=/path/to/python3.12"; exit 1; }
	$(PYTHON) -m venv --clear .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

demo: $(READY)
	$(BIN)/inertrim demo $(ARGS)

test: $(READY)
	$(BIN)/python -m pytest -n 2 --dist worksteal $(ARGS)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(PEERS)
	$(BIN)/python -m benchmarks $(ARGS)

# The peers that are measured against, and the fuzzer, are for benchmarks and long tests only.
$(PEERS): $(READY) requirements-bench.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-bench.lock
	@touch $@

long: $(PEERS)
	$(BIN)/python -m pytest -m long $(ARGS)
	$(BIN)/python -m benchmarks.soak --page docs/reliability.md

# Pins every dependency, with hashes and without addresses, for all supported interpreters (needs `uv`).
lock:
	$(COMPILE) --extra test --extra lint --extra mcap --extra postgres --extra cluster --extra build --output-file requirements.lock
	$(COMPILE) --extra mcap --extra postgres --extra cluster --extra build --constraint requirements.lock --output-file requirements-service.lock
	$(COMPILE) --all-extras --constraint requirements.lock --output-file requirements-bench.lock

clean:
	rm -rf .venv build *.egg-info

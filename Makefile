# hexapod-hil. `make help` lists the targets. Needs Python 3.11 to 3.14 and make, nothing else.
SHELL := /bin/sh
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory
BIN := .venv/bin
UV ?= uv
PYTEST_FLAGS ?=
FUZZ_FLAGS ?=
SOAK_FLAGS ?=
MUTANTS_FLAGS ?=
CLAIMS_FLAGS ?=
# if it is set, each of some hundred test processes compiles the project again
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help run test long fuzz mutants soak lint bench claims docs format lock release publishable portability clean \
	venv fmu kernels viewers releasers

help:  ## list the targets
	@echo "make TARGET, where TARGET is"
	@awk -F ':.*## ' '/^[a-z]+:.*## /{printf "  %-11s %s\n", $$1, $$2}' Makefile

run: fmu  ## run the loop in real time: controller, virtual CAN bus, six drives and the platform's FMU
	@exec $(BIN)/hil run virtual --plant --arm

# compile kernels once, in parallel with mypy; otherwise each test process would compile them
test: venv  ## import contracts, ruff, mypy, pytest (its summary is the last line)
	@$(MAKE) -j2 lint kernels
	@$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist worksteal $(PYTEST_FLAGS)

long: fmu viewers  ## slow checks that `make test` does not run: cost of an extension, many seeds, mutants
	@$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist worksteal -m long -o faulthandler_timeout=1500 $(PYTEST_FLAGS)

fuzz: fmu  ## damaged logs, configurations, CSV files, FMUs ... for ten minutes; FUZZ_FLAGS="--seed 5000" continues at that seed
	@exec $(BIN)/python -m tools.fuzz $(FUZZ_FLAGS)

mutants: fmu  ## a seeded sample of plausible mistakes per area, and the test that detects each; MUTANTS_FLAGS="--area cycle --seed 2"
	@exec $(BIN)/python -m tools.mutants $(MUTANTS_FLAGS)

soak: fmu  ## a day of ticks in lockstep, beyond the overflow of all counters (some hours)
	@exec $(BIN)/python -m tools.soak $(SOAK_FLAGS)

lint: venv  ## import contracts, ruff, mypy
	@$(BIN)/lint-imports --no-logo
	@$(BIN)/ruff check --quiet && echo "ruff check: clean"
	@$(BIN)/ruff format --check --quiet && echo "ruff format: clean"
	@$(BIN)/mypy

bench: fmu  ## benchmark: computing time per tick, wake-up, latency, recorder, replay, FMU
	@exec $(BIN)/python -m tools.benchmarks

claims: fmu  ## measure the figures of README and docs again (docs/claims.yaml), and 200 disturbances and timings of each law
	@PREMISES=200 $(BIN)/python -m pytest -q -n auto --maxprocesses 4 -m "long or not long" -o faulthandler_timeout=1500 \
		tests/docs/test_claims.py tests/loop/test_timing_premises.py $(CLAIMS_FLAGS)

docs: fmu  ## build the documentation, build/docs/index.html; a warning is an error
	@$(BIN)/python -m sphinx -b html -W --keep-going -q docs build/docs
	@echo "build/docs/index.html"

format: venv  ## format with ruff, and fix what ruff can fix
	@$(BIN)/ruff check --fix --quiet; $(BIN)/ruff format

lock:  ## update the lock files (needs uv)
	@UV="$(UV)" sh tools/lock

release: releasers  ## sdist, wheel with the FMUs of five platforms, bill of materials; installed and tried without a compiler
	@exec $(BIN)/python -m tools.release

publishable: releasers  ## the same, refused while tag, date of the changelog or addresses are missing
	@exec $(BIN)/python -m tools.release --publish

portability: venv  ## all tests with each Python in PYTHONS="python3.12 python3.13"; the results go into docs/portability.md
	@exec sh tools/portability $(PYTHONS)

clean:  ## remove .venv, builds and caches; logs in runs/ stay
	@rm -rf .venv build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

venv:
	@python=$$(sh tools/find-python) && exec "$$python" tools/bootstrap.py

fmu: venv
	@exec $(BIN)/hil fmu build

kernels: fmu
	@$(BIN)/python -m tools.compile_kernels

viewers: venv  ## install the extra `viewers` (Rerun, Foxglove; 0.7 GB) into .venv
	@$(BIN)/python -m pip install --quiet --require-hashes --only-binary :all: --no-deps -r requirements-viewers.lock

releasers: venv
	@$(BIN)/python -m pip install --quiet --require-hashes --only-binary :all: --no-deps -r requirements-release.lock

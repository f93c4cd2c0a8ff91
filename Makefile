# Everything a newcomer needs; `make` alone lists it.
.DEFAULT_GOAL := help
SHELL := /bin/bash
PYTHON ?= python3
# Test processes. Each file stays in one process, and gVXR allows one context a process. The third
# works while others wait for nodes.
JOBS ?= 3
PYTEST_ARGS ?=
LOCK_ARGS ?=
VERSIONS_ARGS ?=
# Of each kind of broken input.
MINUTES ?= 10
# Of tools/trials.
TRIALS ?= 400
TRIALS_JOBS ?= 1
SEED ?= 0
VENV := .venv/bin
# Markers of what test-all runs beside test.
LONG := browser or cluster or tutorial or package
# Of the files, only those that may hold such tests are loaded.
LONG_FILES = $(shell grep -rlE --include='test_*.py' 'mark\.(browser|cluster|tutorial|package)' tests)
# Tests that watch real time run alone, after the others; PYTEST_ARGS may leave none of either.
CLOCK_FILES = $(shell grep -rl --include='test_*.py' 'mark\.clock' tests)
# Each source is compiled once, not in each process.
PYTEST = env -u PYTHONDONTWRITEBYTECODE $(VENV)/python -m pytest -q
define run_tests
@$(PYTEST) -n $(JOBS) --dist loadfile -m "($(1)) and not clock" $(or $(PYTEST_ARGS),$(2)) \
	|| $(if $(PYTEST_ARGS),[ $$? = 5 ],false)
@$(PYTEST) -n 0 -m "($(1)) and clock" $(or $(PYTEST_ARGS),$(CLOCK_FILES)) \
	|| $(if $(PYTEST_ARGS),[ $$? = 5 ],false)
endef

# Render without a display.
export MUJOCO_GL ?= egl
export PYTHON

.PHONY: help setup demo paper test test-all quick lint style types format bench fuzz trials qualify docs pictures lock clean bare versions

help: ## List the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' Makefile

setup: ## Install system libraries and the locked packages into .venv
	@tools/setup

demo: setup ## Run the small example (scenarios/demo.yaml)
	@$(VENV)/twinct run scenarios/demo.yaml --out out/demo $$([ ! -e out/demo ] || echo --resume)
	@echo "Report: $(CURDIR)/out/demo/report.html"

paper: setup ## Fetch a real skull and run the paper's experiment (long)
	@tools/fetch-cranium
	@$(VENV)/twinct run scenarios/paper_cranium.yaml --out out/paper $$([ ! -e out/paper ] || echo --resume)
	@echo "Report: $(CURDIR)/out/paper/report.html"

test: style ## Check style and types, run the tests; PYTEST_ARGS="-k sart" chooses, JOBS=0: one process
	@$(MAKE) --no-print-directory -j 2 types quick

quick: setup
	$(call run_tests,not ($(LONG)))

test-all: test ## The same, then what takes long: a browser, a cluster, tutorials, the built package
	@tools/system-libraries browser
	$(call run_tests,$(LONG),$(LONG_FILES))

lint: style types ## Check style, formatting, types and layers only

style: setup
	@$(VENV)/ruff check
	@$(VENV)/ruff format --check

types: setup
	@$(VENV)/pyright
	@$(VENV)/lint-imports --no-cache

format: setup ## Format the code and fix what can be fixed
	@$(VENV)/ruff check --fix --exit-zero
	@$(VENV)/ruff format

bench: setup ## Time the parts of the simulation (benchmarks/)
	@shopt -s nullglob; scripts=(benchmarks/*.py); \
	[ $${#scripts[@]} -gt 0 ] || { echo "No benchmarks yet: put scripts into benchmarks/"; exit 0; }; \
	for script in "$${scripts[@]}"; do echo "== $$script"; $(VENV)/python "$$script" || exit 1; done

fuzz: setup ## Try broken inputs of all kinds, each for MINUTES=10; SEED=1 tries others
	@$(VENV)/python tools/fuzz all --minutes $(MINUTES) --seed $(SEED)

trials: setup ## Let faults meet the commands while they work: TRIALS=400, TRIALS_JOBS=1 at a time; SEED=1 draws others
	@$(VENV)/python tools/trials --trials $(TRIALS) --jobs $(TRIALS_JOBS) --seed $(SEED)

qualify: setup ## Let BAM's toolbox judge our images (CTSimU suite; 20 minutes)
	@$(VENV)/twinct ctsimu qualify --out out/qualify

docs: setup ## Build the documentation site into build/site; its tutorials run meanwhile
	@$(VENV)/python tools/check_links.py
	@$(VENV)/python -m sphinx -q -W --keep-going docs build/site
	@echo "Site: $(CURDIR)/build/site/index.html"

pictures: setup ## Draw the pictures of X-ray effects in docs/images anew
	@$(VENV)/python docs/pictures/physics.py

bare: ## Type the lines of the README on a bare Debian 12, with the seconds of each (root, debootstrap)
	@tools/bare-machine

versions: setup ## Try the wheel on Python 3.11 to 3.13 with the newest and the lowest versions; VERSIONS_ARGS="--python 3.12 --extras all"
	@$(VENV)/python tools/versions $(VERSIONS_ARGS)

lock: ## Refresh constraints.txt; LOCK_ARGS=--upgrade takes the newest versions
	@tools/lock $(LOCK_ARGS)

clean: ## Remove results, caches and builds (keeps .venv and data/)
	rm -rf out build dist .pytest_cache .ruff_cache .import_linter_cache
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +

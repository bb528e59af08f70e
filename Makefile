# The commands of the README. Each sets up what is missing first.
VENV := .venv
BIN := $(VENV)/bin
PIP := PIP_DISABLE_PIP_VERSION_CHECK=1 $(BIN)/pip install --quiet --constraint constraints.txt

# A rig is eight processes, and the tests start hundreds: none is to translate the package anew.
export PYTHONDONTWRITEBYTECODE :=

# One more than processors: some tests wait.
WORKERS := $(shell expr $$(nproc) + 1)
MEASURED := --cov microbot_ros --cov-report term:skip-covered --cov-report json:out/coverage.json

.PHONY: setup demo test logic test-rig soak coverage compiled bench foreign docs lowest sizes lint clean

# The first of these that is Python 3.12 or 3.11 and can make environments.
PYTHON := $(shell for p in python3.12 python3.11 python3; do \
	$$p -c 'import ensurepip, sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' \
	2>/dev/null && { echo $$p; break; }; done)

setup: $(VENV)/.runtime

$(VENV)/.runtime: setup.py constraints.txt
	@if [ -z "$(PYTHON)" ]; then \
		echo 'microbot_ros needs Python 3.12 or 3.11 with venv (Debian, Ubuntu: apt install python3-venv); found neither.' >&2; \
		exit 2; fi
	@echo "setting up $(VENV) with $(PYTHON): ROS 2 Jazzy and the libraries from PyPI, about a minute"
	@[ -x $(BIN)/python ] || $(PYTHON) -m venv $(VENV)
	@$(PIP) --editable '.[ros,all]'
	@touch $@

$(VENV)/.development: $(VENV)/.runtime
	@echo 'adding the tools for tests and benchmarks, about a minute'
	@$(PIP) --editable '.[ros,dev]'
	@touch $@

demo: $(VENV)/.runtime
	@$(BIN)/microbot demo --out out/demo

# All logic, in process: `make test COVERAGE=1` also prints the line coverage. The lint, a process
# of 30 s, runs beside it; what it finds is printed at once, and that it failed at the end.
test: compiled
	@$(MAKE) --no-print-directory --jobs 2 lint logic

# The time-out is for tests that hang: on a busy machine one of 11 s took over 120 s.
logic: $(VENV)/.development
	@$(BIN)/python -m pytest -m 'not rig and not soak' --numprocesses $(WORKERS) --dist loadfile \
		--timeout 600 $(if $(COVERAGE),$(MEASURED))

# Real processes, signals, browser, firmware and milliseconds: alone on the machine. A failed test
# is run again up to three times; the ledger is in out/retries.json.
test-rig: $(VENV)/.development compiled
	@$(BIN)/python -m pytest -m 'rig and not soak' --retries 3

# Statistics, long stories, mutants of the drive, and the core on its oldest libraries: hours.
soak: $(VENV)/.development compiled
	@$(BIN)/python -m pytest -m soak
	@$(BIN)/python -m bench._mutants
	@$(MAKE) --no-print-directory lowest

coverage:
	@$(MAKE) --no-print-directory test COVERAGE=1

# Compile once what several processes need, before they start; what was compiled of the same
# sources, in whatever clone, is not compiled again.
compiled: $(VENV)/.development
	@$(BIN)/python test/harness/warm.py

lint: $(VENV)/.development
	@$(BIN)/ruff check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-logo
	@$(BIN)/python test/lint.py

# Within an hour; `make bench FULL=1` takes all runs of every group, `make bench ONLY=tracker` one,
# `make bench ONLY=judge CASES=3` three sessions of each kind.
bench: $(VENV)/.development
	@$(BIN)/python -m bench $(if $(ONLY),--only $(ONLY)) $(if $(FULL),--full) $(if $(CASES),--cases $(CASES))

# Simulators of other projects, by which discovery is judged, in an environment of their own.
FOREIGN := out/foreign
foreign: $(FOREIGN)/.ready

$(FOREIGN)/.ready: bench/foreign/requirements.txt
	@echo 'setting up the foreign simulators in $(FOREIGN), about 10 minutes: pystokes is compiled'
	@[ -x $(FOREIGN)/bin/python ] || $(PYTHON) -m venv $(FOREIGN)
	@PIP_DISABLE_PIP_VERSION_CHECK=1 $(FOREIGN)/bin/pip install --quiet \
		'setuptools<80' wheel cython numpy scipy
	@PIP_DISABLE_PIP_VERSION_CHECK=1 $(FOREIGN)/bin/pip install --quiet --no-build-isolation \
		--requirement bench/foreign/requirements.txt
	@touch $@

# The documents as HTML, in out/docs; what is made from the code is made anew.
docs: $(VENV)/.development
	@$(BIN)/python docs/build.py --notebooks
	@$(BIN)/python -m sphinx --quiet --fail-on-warning docs out/docs
	@echo 'out/docs/index.html'

# The tests of the core in an environment of its own, with the oldest libraries that setup.py allows.
lowest:
	@$(PYTHON) test/lowest.py out/lowest

# Time and size of pip install: the core, with ROS, with all extras.
sizes: $(VENV)/.runtime
	@$(BIN)/python test/install.py

clean:
	rm -rf $(VENV) out build install log .mypy_cache .ruff_cache *.egg-info

# make demo   set everything up and run the paper's experiment: tables, figures and report in results/
# make test   set everything up, build the wheel and run every test against it
# make fuzz   100 000 drawn sequences of FMI calls of each kind of FMU, under the sanitizers
# make bench  how fast everything is, against its targets and against the figures of the last release
# make check  formatting, linting, types and the fast tests, from the source tree: a quick look before a commit
# make lint   formatting, linting, types, and where the lines are
# make docs   the documentation as a site in build/site; warnings are errors

PYTHON ?= python3
# a C compiler from PyPI where the machine has none
EXTRAS := $(if $(shell command -v cc || command -v gcc || command -v clang),,[zig])
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test check fast fuzz bench lint docs format clean
.DEFAULT_GOAL := demo

demo: $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --editable ".$(EXTRAS)"
	$(BIN)/flexfmu paper --out results/paper
	$(BIN)/flexfmu run barnard2012-6kg --out results/barnard2012-6kg
	@echo "Open results/paper/report.html and results/barnard2012-6kg/report.html in a browser."

# the tests run against the installed wheel, never against the source tree; three at a time on two cores, since some wait for other programs
test: $(VENV)/.test
	rm -rf build/wheel build/lib && $(BIN)/python -m build --quiet --wheel --outdir build/wheel .
	$(BIN)/python -m pip install --quiet --force-reinstall --no-deps build/wheel/*.whl
	$(BIN)/python -m pytest -n 3 --dist worksteal $(PYTEST_ARGUMENTS)

# types and the first tests side by side, on two cores
check: $(VENV)/.lint $(VENV)/.test
	$(BIN)/python -m pip install --quiet --editable ".$(EXTRAS)"
	$(MAKE) --no-print-directory --jobs 2 --output-sync=target lint fast

fast:
	$(BIN)/python -m pytest -n 2 --dist worksteal -q -m "not slow" $(PYTEST_ARGUMENTS)

fuzz: $(VENV)/.test
	$(BIN)/python -m pip install --quiet --editable ".$(EXTRAS)"
	FLEXFMU_FUZZ=100000 $(BIN)/python -m pytest -n 2 --durations=0 tests/fmu_boundary/test_fuzzing.py

bench: $(VENV)/.test
	$(BIN)/python -m pip install --quiet --editable ".$(EXTRAS)"
	$(BIN)/python benchmarks/speed.py $(BENCH_ARGUMENTS)

lint: $(VENV)/.lint
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	rm -rf build/typing && mkdir -p build/typing/flexfmu/benchmarks
	for part in src/flexfmu/*.py* model fmu_build trajectories cosim; do ln -s ../../../$$part build/typing/flexfmu; done
	ln -s ../../../../benchmarks/hard_cases build/typing/flexfmu/benchmarks
	$(BIN)/mypy build/typing/flexfmu
	$(BIN)/python generators/size.py

docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict
	@echo "Open build/site/index.html in a browser."

format: $(VENV)/.lint
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"

$(VENV)/.test: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet build --group test ".$(EXTRAS)"
	touch $@

$(VENV)/.lint: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --group lint --group test ".$(EXTRAS)"
	touch $@

$(VENV)/.docs: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --group docs
	touch $@

clean:
	rm -rf build dist results .pytest_cache .mypy_cache .ruff_cache *.egg-info

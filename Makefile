# make demo      set everything up and run the paper's experiment: tables, figures and report in results/
# make test      set everything up and run all tests that aren't marked slow, against the built wheel: five minutes on two cores
# make test-all  make test, then make slow: everything
# make slow      the slow tests, against the built wheel: examples, other people's tools, whole studies, every variant
# make test-lowest  the tests of make test with the oldest dependencies that pyproject.toml allows
# make fuzz      100 000 drawn sequences of FMI calls of each kind of FMU, under the sanitizers, and drawn files for each reader: an hour
# make licences  the licences of flexfmu and of what is installed with it
# make bench     how fast everything is, against its targets and against the figures of the last release
# make check     make lint and make test side by side: before a commit
# make lint      formatting, linting, types, and where the lines are
# make dist      the source distribution, the wheel made from it, and their descriptions checked, in dist/
# make docs      the documentation as a site in build/site; warnings are errors

PYTHON ?= python3
# a C compiler from PyPI where the machine has none
EXTRAS := $(if $(shell command -v cc || command -v gcc || command -v clang),,[zig])
VENV := .venv
BIN := $(VENV)/bin

# modules are compiled once: by the installer, or when they are first imported
export UV_COMPILE_BYTECODE := 1
export PYTHONDONTWRITEBYTECODE :=
# uv installs in seconds what takes pip a minute; pip does it where uv finds no packages (behind a mirror that pip alone knows)
install = $(BIN)/uv pip install --quiet --python $(BIN)/python $(1) || $(BIN)/python -m pip install --quiet $(1)
# tests run against the installed wheel, never against the source tree
install_wheel = rm -rf build/lib && { $(call install,--force-reinstall --no-deps .); }

.PHONY: demo test test-all test-lowest slow check fuzz licences bench lint docs dist format clean
.DEFAULT_GOAL := demo

demo: $(VENV)/bin/python
	$(call install,--editable ".[zig]")
	$(BIN)/flexfmu paper --out results/paper
	$(BIN)/flexfmu run barnard2012-6kg --accuracy peak_torque_1=1e-3 --accuracy residual_vibration_amplitude=1e-2 --out results/barnard2012-6kg
	$(BIN)/flexfmu workprec barnard2012-6kg --of peak_torque_1,residual_vibration_amplitude --out results/workprec > results/workprec.txt
	$(BIN)/flexfmu workprec --hard --out results/hard-cases > results/hard-cases.txt
	$(BIN)/flexfmu run barnard2012-6kg --live --out results/live
	@echo "Open results/live/report.html, which simulates, results/paper/report.html, results/barnard2012-6kg/report.html and, for what accuracy costs, results/workprec/workprec.html and results/hard-cases/hard-cases.html in a browser."

test: $(VENV)/.test
	$(install_wheel)
	$(BIN)/python -m pytest -n 2 --dist worksteal -q -m "not slow" $(PYTEST_ARGUMENTS)

test-all:
	$(MAKE) --no-print-directory test
	$(MAKE) --no-print-directory slow

# three at a time on two cores, since some wait for other programs
slow: $(VENV)/.slow
	$(install_wheel)
	$(BIN)/python -m pytest -n 3 --dist worksteal -q -m slow $(PYTEST_ARGUMENTS)

# wheels alone: the oldest source distributions don't build any more; what they call deprecated is their own concern
test-lowest: $(VENV)/bin/python
	mkdir -p build
	$(BIN)/uv pip compile --quiet --resolution lowest-direct --only-binary :all: --all-extras --python $(PYTHON) pyproject.toml -o build/lowest.txt
	$(BIN)/uv venv --quiet --clear --python $(PYTHON) build/lowest
	$(BIN)/uv pip install --quiet --python build/lowest/bin/python --constraint build/lowest.txt --group test .
	build/lowest/bin/python -m pytest -n 2 --dist worksteal -q -m "not slow" -W ignore::DeprecationWarning $(PYTEST_ARGUMENTS)

check: $(VENV)/.lint $(VENV)/.test
	$(MAKE) --no-print-directory --jobs 2 --output-sync=target lint test

fuzz: $(VENV)/.slow
	$(call install,--editable ".$(EXTRAS)")
	FLEXFMU_FUZZ=100000 $(BIN)/python -m pytest -n 2 --durations=0 -rfEsP tests/fmu_boundary/test_fuzzing.py tests/integration/test_drawn_files.py

licences: $(VENV)/bin/python
	$(call install,--editable ".$(EXTRAS)")
	$(BIN)/python generators/licences.py

bench: $(VENV)/.slow
	$(call install,--editable ".$(EXTRAS)")
	$(BIN)/python benchmarks/speed.py $(BENCH_ARGUMENTS)

lint: $(VENV)/.lint
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	rm -rf build/typing && mkdir -p build/typing/flexfmu/benchmarks
	for part in src/flexfmu/*.py* model fmu_build trajectories cosim; do ln -s ../../../$$part build/typing/flexfmu; done
	ln -s ../../../../benchmarks/hard_cases ../../../../benchmarks/peers build/typing/flexfmu/benchmarks
	$(BIN)/mypy build/typing/flexfmu
	$(BIN)/python generators/size.py

docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict
	@echo "Open build/site/index.html in a browser."

dist: $(VENV)/bin/python
	rm -rf dist
	$(call install,build twine)
	$(BIN)/python -m build --quiet
	$(BIN)/twine check --strict dist/*

format: $(VENV)/.lint
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1" uv

$(VENV)/.%: pyproject.toml | $(VENV)/bin/python
	$(call install,--group $* ".$(EXTRAS)")
	touch $@

clean:
	rm -rf build dist results .pytest_cache .mypy_cache .ruff_cache *.egg-info

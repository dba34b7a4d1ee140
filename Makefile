# Everything sets itself up in .venv: a Python of 3.11 or later and a C++ compiler are all that has to be there.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CORE := CMakeLists.txt $(wildcard factors/*)
CTEST := build/ctest

STUDIES := sampling_space distance sample_count pointing traces sweeps ranges_needed beside_bound beside_recordings

.PHONY: demo test lint bench experiments clean

demo: $(VENV)/installed
	$(BIN)/python -m experiments.demo --out demo

test: $(VENV)/tested-with $(CTEST)/built
	$(BIN)/ctest --test-dir $(CTEST) --output-on-failure
	$(BIN)/python -m pytest

lint: $(VENV)/linted-with $(CTEST)/built
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/clang-format --dry-run --Werror $(wildcard factors/*.h factors/*.cpp tests/cpp/*)
	$(BIN)/clang-tidy --quiet -p $(CTEST) $(filter-out factors/bindings.cpp,$(wildcard factors/*.cpp))

bench: $(VENV)/installed
	$(BIN)/python -m experiments.bench

# Quickly; at the paper's size with `make experiments SIZE=--full`.
experiments: $(VENV)/tested-with
	@for study in $(STUDIES); do echo "== $$study"; $(BIN)/python -m experiments.$$study $(SIZE) || exit 1; done

clean:
	rm -rf $(VENV) build demo

$(VENV)/ready: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --group build
	touch $@

# Without isolation, so that the tests' own build of the core finds the same Eigen.
$(VENV)/installed: $(VENV)/ready $(CORE)
	$(BIN)/python -m pip install --quiet --no-build-isolation --editable .
	$(BIN)/python -c "import synchronizar._core"
	touch $@

$(VENV)/tested-with: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --group test
	touch $@

$(VENV)/linted-with: $(VENV)/tested-with
	$(BIN)/python -m pip install --quiet --group lint
	touch $@

$(CTEST)/built: $(VENV)/ready $(CORE) $(wildcard tests/cpp/*)
	$(BIN)/cmake -S . -B $(CTEST) -G Ninja -DPYTHON_MODULE=OFF -DCORE_TESTS=ON \
		-DCMAKE_MAKE_PROGRAM=$(abspath $(BIN))/ninja -DPython_EXECUTABLE=$(abspath $(BIN))/python
	$(BIN)/cmake --build $(CTEST)
	touch $@

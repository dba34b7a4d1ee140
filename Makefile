# Everything sets itself up in .venv: a Python of 3.11 or later and a C++ compiler are all that has to be there. What the
# firmware's tests run in besides is installed by apt where it can be; what cannot be had is skipped, and said.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CORE_SOURCES := $(wildcard factors/*.cpp firmware/core/*.c firmware/sim/*.cpp firmware/targets/host/*.cpp)
CORE := CMakeLists.txt firmware/CMakeLists.txt $(wildcard bindings/*.cpp) $(CORE_SOURCES) $(wildcard $(addsuffix /*.h,bindings factors firmware/core firmware/sim firmware/targets/host))
CORE_TESTS := $(wildcard tests/cpp/* firmware/tests/*.[ch] firmware/tests/*/*.[ch] firmware/tests/*/*.cpp)
# The package is built where its core's tests are: what both need is compiled once.
CTEST := build/ctest
FIRMWARE_TESTS := PATH="$(abspath $(BIN)):$$PATH" firmware/tests/run.sh

# How long each of the firmware's fuzz targets runs.
export FUZZ_SECONDS ?= 5

STUDIES := $(addprefix paper.,sampling_space distance sample_count pointing traces) \
	$(addprefix sweeps.,sweeps ranges_needed beside_bound beside_recordings)

.PHONY: demo live modules test fuzz ctest lint audit docs sizes bench experiments integrity clean

demo: $(VENV)/installed
	$(BIN)/python -m experiments.demo --out demo

# A room on this machine, with walkers whose modules range in the simulated air, and the page that shows them.
live: $(VENV)/tested-with
	$(BIN)/python -m experiments.live.room

# The modules' firmware in the simulated air, from walks to registration.
modules: $(VENV)/tested-with
	$(BIN)/python -m experiments.modules.end_to_end

# What keeps one core busy runs beside what keeps the other: packages beside compilers, fuzzers beside tests in C and C++.
test:
	-for tool in riscv fuzz chromium npm; do tools/have.sh $$tool; done
	+$(MAKE) --jobs=2 $(VENV)/tested-with $(CTEST)/built
	+$(MAKE) --jobs=2 fuzz ctest
	$(BIN)/python -m pytest --numprocesses=logical --dist=worksteal

# Lines with a + give make's jobs to ninja and ctest, which share them: each fuzzer has a core.
fuzz: $(VENV)/ready
	+$(FIRMWARE_TESTS) fuzz

ctest: $(CTEST)/built
	+$(BIN)/ctest --test-dir $(CTEST) --output-on-failure --parallel 2
	+$(FIRMWARE_TESTS) sanitized riscv
	$(BIN)/python firmware/tests/mutations.py $(CTEST)

lint: $(VENV)/linted-with $(CTEST)/built
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy --num-workers=2
	$(BIN)/clang-format --dry-run --Werror $(filter-out %.txt,$(CORE) $(CORE_TESTS)) \
		$(wildcard firmware/targets/esp-idf/*/*.[ch] firmware/targets/esp-idf/*/*/*.[ch])
	printf '%s\n' $(CORE_SOURCES) | xargs -P 2 -n 2 $(BIN)/clang-tidy --quiet -p $(CTEST)
	if tools/have.sh cppcheck; then cppcheck --quiet --enable=warning,performance,portability,style --error-exitcode=1 \
		-I firmware/core firmware/core firmware/targets/esp-idf; fi
	if tools/have.sh npm; then npm install --silent --no-audit --no-fund --prefix build/eslint eslint@10.15.0 && \
		build/eslint/node_modules/.bin/eslint --max-warnings 0 synchronizar/live/pages synchronizar/reporting synchronizar/apps \
		tests/live/js tests/apps/js examples; fi

# Known vulnerabilities of what is installed, where PyPI can be asked.
audit: $(VENV)/installed
	$(BIN)/python tools/audit.py $(VENV)

# The pages of docs/ in build/docs; a warning, or a link that leads nowhere, is an error.
docs: $(VENV)/documented-with
	rm -rf build/docs
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet --builder html docs build/docs
	$(BIN)/python tools/check_links.py build/docs

# The table of the core's size on each processor.
sizes: $(VENV)/ready
	-for compiler in riscv arm xtensa; do tools/have.sh $$compiler; done
	$(BIN)/python firmware/tests/sizes.py

bench: $(VENV)/installed
	$(BIN)/python -m experiments.performance.bench

# Quickly; at the paper's size with `make experiments SIZE=--full`.
experiments: $(VENV)/tested-with
	@for study in $(STUDIES); do echo "== $$study"; $(BIN)/python -m experiments.$$study $(SIZE) || exit 1; done

# How far `registered` can be relied on, over every fault at hand, in half an hour; the last word with `SEEDS=judge`.
SEEDS ?= build
integrity: $(VENV)/tested-with
	$(BIN)/python -m experiments.integrity --seeds $(SEEDS)

clean:
	rm -rf $(VENV) build demo

$(VENV)/ready: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --group build
	touch $@

# An editable install keeps a list of the package's modules: it is made anew when one comes, goes or moves.
$(VENV)/modules: $(VENV)/ready FORCE
	@find synchronizar -name '*.py' | LC_ALL=C sort | cmp --quiet - $@ || find synchronizar -name '*.py' | LC_ALL=C sort >$@

FORCE:

# Without isolation, so that the tests' own build of the core finds the same Eigen.
$(VENV)/installed: $(VENV)/modules $(CORE)
	$(BIN)/python -m pip install --quiet --no-build-isolation --config-settings=build-dir=$(CTEST) \
		--config-settings=cmake.define.CMAKE_COMPILE_WARNING_AS_ERROR=$(or $(CI),OFF) \
		--config-settings=cmake.define.PYTHON_MODULE=ON \
		--editable ".[webtransport,webrtc,mcap,ros]"
	$(BIN)/python -c "import synchronizar._core"
	touch $@

$(VENV)/tested-with: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --group test
	touch $@

$(VENV)/linted-with: $(VENV)/tested-with
	$(BIN)/python -m pip install --quiet --group lint
	touch $@

$(VENV)/documented-with: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --group docs
	touch $@

$(CTEST)/built: $(VENV)/installed $(CORE_TESTS)
	$(BIN)/cmake -S . -B $(CTEST) -DCORE_TESTS=ON -DCMAKE_COMPILE_WARNING_AS_ERROR=$(or $(CI),OFF)
	+$(BIN)/cmake --build $(CTEST)
	touch $@

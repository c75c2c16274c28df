# make demo: sets up and runs the main job on embedded data, and names the page to open.
# make test: sets up and passes style, types and the quick tests, one of every capability.
# make deep: the slow tests: whole logs, measured cells, hidden effects, every page of the docs.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

# One thread per process for linear algebra: the matrices are small and the tests run in parallel.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: setup demo test deep check oracles papers benchmark firmware pages clean

setup: $(STAMP)

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet --editable '.[dev,report]'
	touch $(STAMP)

demo: $(STAMP)
	$(BIN)/cellwise demo -o demo

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# What most tests need is compiled on one core while types are checked on the other. Tests of one
# module stay together: what they share is made once.
test: $(STAMP)
	CELLWISE_QUIET=1 $(BIN)/python tests/compile_kernels.py & $(MAKE) check && wait
	$(BIN)/pytest -n 2 --dist worksteal -m "not slow" --hypothesis-profile quick

# What `make firmware` and `make pages` run is left to them.
deep: $(STAMP)
	$(BIN)/pytest -n 2 --dist worksteal -m slow --ignore tests/firmware --ignore tests/report/test_in_browser.py \
	  --ignore tests/export --ignore tests/estimate/fixed/test_twin.py

# Other people's implementations as oracle: PyBaMM, thevenin, importers, checks of manifests.
oracles: $(STAMP)
	$(BIN)/pip install --quiet --editable '.[benchmark,checks]'
	$(BIN)/pytest tests/benchmarks/test_benchmark_peers.py tests/datasets/test_generator.py \
	  tests/export/test_pybamm_parameters.py tests/export/test_fmu.py \
	  tests/export/test_layouts.py tests/logs/test_log_writing.py tests/benchmark/certify/test_lives.py

papers: $(STAMP)
	$(BIN)/cellwise papers

benchmark: $(STAMP)
	$(BIN)/pip install --quiet --editable '.[benchmark]'
	$(BIN)/python -m benchmarks.speed
	$(BIN)/python -m benchmarks.accuracy
	$(BIN)/python -m benchmarks.firmware

# Cross compiler, emulator and proof from Debian; then everything that needs them.
FIRMWARE_PACKAGES := gcc gcc-arm-none-eabi libnewlib-arm-none-eabi libc6-dev qemu-system-arm frama-c-base cppcheck \
	clang libclang-rt-14-dev lld cmake
RISCV_PACKAGES := gcc-riscv64-unknown-elf qemu-system-misc
firmware: $(STAMP)
	.ci/debian arm-none-eabi-gcc qemu-system-arm frama-c cppcheck clang wasm-ld cmake -- $(FIRMWARE_PACKAGES)
	.ci/debian riscv64-unknown-elf-gcc qemu-system-riscv32 -- $(RISCV_PACKAGES) || \
	  echo "no RISC-V tools: its tests are skipped"
	$(BIN)/pytest -n 2 --dist worksteal tests/firmware tests/export tests/estimate/fixed/test_twin.py

# Debian's Chromium, and every page opened in it.
pages: $(STAMP)
	.ci/debian chromium clang wasm-ld -- chromium clang lld
	$(BIN)/pytest tests/report/test_in_browser.py tests/export/test_page.py

clean:
	rm -rf $(VENV) demo

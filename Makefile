# make demo: sets up and runs the main job on embedded data, and names the page to open.
# make test: sets up and passes every check and test.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

# One thread per process for linear algebra: the matrices are small and the tests run in parallel.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: setup demo test check papers benchmark clean

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

test: check
	$(BIN)/pytest -n 2

papers: $(STAMP)
	$(BIN)/cellwise papers

benchmark: $(STAMP)
	$(BIN)/pip install --quiet --editable '.[benchmark]'
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/accuracy.py

clean:
	rm -rf $(VENV) demo

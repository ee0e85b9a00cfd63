# make demo    from recordings to two simulators, the table that compares them, a policy from each,
#              and a blind test: about five minutes on 2 free cores, beside downloads
# make test    lint, types and tests: about eight minutes on 2 free cores from a fresh clone
# Each alone takes a fresh clone to the end: it makes .venv and installs into it what it needs.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
# Extra arguments of pip for PyTorch, e.g. its index of CPU builds (see README, "Installation").
TORCH_OPTIONS ?=
BIN := .venv/bin
SOURCE := src/buggy_rl
# What kernels follow from, as `buggy_rl.core.kernels` has it.
KERNELS := $(addprefix $(SOURCE)/,core/kernels.py core/vehicle.py simulators effects)
# One thread a process unless a script is told otherwise: several busy OpenMP teams on few cores
# slow one another down many times over.
export OMP_NUM_THREADS ?= 1
export OMP_WAIT_POLICY ?= PASSIVE
# Byte code is written, whatever is usual here: each process of a test imports the same packages.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test tests test-slow lint types types-slow install clean

demo: .venv/package
	$(BIN)/python scripts/demo.py

# Kernels are compiled beside the installation of the extras.
test: .venv/package
	$(MAKE) --jobs=2 lint types tests

# By files, in their order: tests of a file share what its fixtures make, and the first are longest.
tests: .venv/installed .venv/kernels lint
	$(BIN)/python -m pytest -q -n 2 --dist loadfile --no-loadscope-reorder

test-slow: .venv/installed .venv/peers .venv/kernels types-slow
	$(BIN)/python -m pytest -q -m slow --timeout 3600

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: lint
	$(BIN)/pyrefly check --summary=none --python-interpreter-path $(BIN)/python

# A second reading, stricter of packages without annotations: a minute.
types-slow: .venv/installed
	$(BIN)/pyright --pythonpath $(BIN)/python

install: .venv/package
	@$(MAKE) --jobs=2 .venv/installed .venv/kernels
	@$(BIN)/python scripts/compile.py only=effects || \
	    echo "nothing compiled: effects run by PyTorch, slower"

# The package without its extras: all that the demo needs, which compiles for itself. --no-compile:
# Python writes its byte code as modules are imported, of which the demo needs a part.
.venv/package: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --no-compile $(TORCH_OPTIONS) torch==2.13.0+cpu || { \
	    echo "pip knows no CPU build of torch 2.13.0: taking the default one (on Linux with" ; \
	    echo "gigabytes of CUDA packages; README, Installation, says how to avoid them)" ; \
	    $(BIN)/pip install --no-compile $(TORCH_OPTIONS) torch==2.13.0 ; }
	$(BIN)/pip install --no-compile -e .
	touch $@

.venv/installed: .venv/package
	$(BIN)/pip install --no-compile -e '.[dev]'
	touch $@

.venv/peers: .venv/installed
	$(BIN)/pip install --no-compile -e '.[peers]'
	touch $@

# Kernels with which the tests are faster, compiling included; in one process, which imports the
# compiler once and takes the processor at its word. By the source itself: pip takes the package out
# and puts it back meanwhile.
.venv/kernels: .venv/package $(shell find $(KERNELS) -name '*.py')
	@PYTHONPATH=src TORCHINDUCTOR_VEC_ISA_OK=1 TORCHINDUCTOR_COMPILE_THREADS=1 \
	    $(BIN)/python scripts/compile.py only=engines workers=1 || \
	    echo "nothing compiled: simulators run by PyTorch, slower"
	touch $@

clean:
	rm -rf .venv build demo

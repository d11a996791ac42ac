# `make demo` and `make test` do all set-up themselves; they need Python 3.11 or newer and make.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test test-all test-vulkan lowest training lint docs figures gpu-parity bench clean

demo: .venv/use
	$(BIN)/lfgpu demo

# The longest tests come in the middle of the alphabet: workers that are done take over what others have before them.
PYTEST := $(BIN)/python -m pytest -n auto --maxprocesses 4 --dist worksteal

test: .venv/develop
	$(PYTEST) -m "not thorough"

# What `make test` leaves out: faults that tests must notice, benchmarks, wheels, kernels of a GPU on a CPU, kills, load,
# C++ compilers, whole estimates and special cases of kernels by other backends than the default, the scenes of trainings,
# and most of what is looked at in a browser.
test-all: test
	$(PYTEST) -m thorough
	$(BIN)/python -m tests.io.fuzz --examples 2000 --seed 1 --processes 2
	$(BIN)/python tests/faults.py

# Operations, whole estimates, tiles, batches and memory by Taichi on a Vulkan driver: a GPU's, or Mesa's without one.
test-vulkan: .venv/develop
	$(PYTEST) tests/kernels/test_matrix.py tests/test_pipelines.py tests/test_depth_pipeline.py tests/test_vulkan.py \
		--backend taichi --device vulkan

# The least versions of all packages that pyproject.toml allows, and what reads, writes and computes with them. They have
# wheels for Python 3.11, which uv looks for, or loads.
lowest:
	$(PYTHON) -m venv .venv-lowest
	.venv-lowest/bin/python -m pip install --quiet --disable-pip-version-check uv
	.venv-lowest/bin/uv venv --quiet --clear --python 3.11 .venv-lowest/packages
	.venv-lowest/bin/uv pip install --quiet --python .venv-lowest/packages --resolution lowest-direct \
		-e ".[test,viewer,opencv]"
	.venv-lowest/packages/bin/python -m pytest -n auto --maxprocesses 4 --dist worksteal -m "not thorough" \
		tests/io/test_every_format.py tests/io/test_images.py tests/io/test_map_formats.py tests/io/test_old_hci.py \
		tests/calibration/test_calibration_formats.py tests/test_batch_items.py tests/test_batch_manifest.py \
		tests/test_stream.py tests/test_stream_frames.py tests/test_doctor.py \
		tests/test_geometry.py tests/viewer/test_guard.py

# What needs PyTorch: the generator, the network, and `lfgpu train` from a light field to weights.
training:
	$(PYTHON) -m venv .venv-training
	.venv-training/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
		-e ".[train]" pytest hypothesis
	.venv-training/bin/python -m pytest tests/training tests/test_learned.py

lint: .venv/develop
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

gpu-parity: .venv/develop
	$(BIN)/python -m benchmarks gpu-parity

docs: .venv/develop
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs build/site
	@echo "The site is in build/site: open build/site/index.html"

figures: .venv/develop
	$(BIN)/python -m benchmarks figures

bench: .venv/develop
	$(BIN)/python -m benchmarks

clean:
	rm -rf .venv .venv-lowest .venv-training build dist docs/made lfgpu-demo

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "lfgpu needs Python 3.11 or newer; name one with: make PYTHON=/path/to/python3.12 ...")'
	$(PYTHON) -m venv .venv

.venv/use: .venv/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[viewer]"
	@touch $@

.venv/develop: .venv/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[all]"
	@touch $@

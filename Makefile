# The front door. `make help` lists what there is.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

PYTHON := .venv/bin/python
BUILD := build
# One compile job takes up to 1.5 GB.
JOBS := $(shell awk -v n=$$(nproc) '/MemAvailable/ {m = int($$2 / 1572864); if (m < 1) m = 1; print (m < n) ? m : n}' /proc/meminfo)

# make run: the twin of BOARD, or a recording INPUT=VIDEO with ball presses PRESSES=DIR.
INPUT ?=
PRESSES ?=
BOARD ?= $(if $(INPUT),gelsight-mini,gelslim)
OUT ?= out/$(if $(INPUT),$(BOARD),run)
SUITE ?= bookworm
# 1: make bench does less; its figures are then not the README's.
QUICK ?=
# Seconds for each fuzzer.
FUZZ_S ?= 60
# For those that do a hundred thousand executions in 20 s; the others keep FUZZ_S.
FUZZ_FAST_S ?= $(FUZZ_S)
# 1: make fuzz adds its executions to tests/ledger.toml.
LEDGER ?=
# 1, as in CI: warnings are errors in build/ itself, with the benchmarks in it; make werror then compiles nothing twice.
WERROR ?=
STRICT := -DRUFFINI_WERROR=ON -DRUFFINI_BENCH=ON

.PHONY: help setup build run test test-realtime readmes lint lint-docs lint-python lint-page lint-format lint-cpp werror docs sanitize fuzz coverage simulate soak mutants hostile gels resolution steady bench profile oracle aarch64 wheel wheels deb arm64 vm pi board fresh version release clean
help:  ## this list
	@grep -E '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## */\t/' | expand -t 12

setup:  ## install Debian packages and .venv (needs root or sudo the first time)
	@.ci/setup

# $(call compile,FOLDER,CMAKE OPTIONS,TARGETS)
compile = log=$$(cmake -G Ninja -S . -B $(1) $(2) 2>&1) || { echo "$$log" >&2; exit 1; }; \
  cmake --build $(1) -j $(JOBS) $(if $(3),--target $(3))

build: setup  ## compile firmware, library and tests into build/
	@$(call compile,$(BUILD),$(if $(WERROR),$(STRICT),-DRUFFINI_WERROR=OFF))

# What it and the page of `ruffini view` run, and no test.
RUN := ruffinid ruffini ruffini_schema ruffini_page
run: setup  ## the whole path once: INPUT=VIDEO PRESSES=DIR BOARD=NAME, or the digital twin without INPUT
	@$(call compile,$(BUILD),$(if $(WERROR),$(STRICT),-DRUFFINI_WERROR=OFF),$(RUN))
	@.venv/bin/ruffini demo --board '$(BOARD)' --out '$(OUT)' $(if $(INPUT),--input '$(INPUT)') $(if $(PRESSES),--presses '$(PRESSES)')

# Test modules run longest first, by what each took last time; each stays with one worker, whose fixtures it shares.
# Bytecode is kept also where the environment forbids it: pytest's own of the tests takes six seconds in every worker.
# A worker waits half of its time for daemons, pages and shells, so five workers for two cores keep them busy.
PYTEST = PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTHON) -m pytest -c host/pyproject.toml -n $$(($(JOBS) * 5 / 2)) \
  --dist loadfile --no-loadscope-reorder --durations 10 --durations-min 1
ONLY ?=
ifdef ONLY
# support_solver -> SupportSolver, as its C++ tests are called.
PASCAL = $(shell sed -E 's/(^|_)([a-z])/\U\2/g' <<< '$(ONLY)')
TESTED := ruffini ruffini_schema ruffini_stages ruffini_tests ruffini_device_tests
test: setup  ## all tests that need no hardware; ONLY=NAME: those of one part, e.g. ONLY=support_solver
	@$(call compile,$(BUILD),$(if $(WERROR),$(STRICT),-DRUFFINI_WERROR=OFF),$(TESTED))
	@$(BUILD)/ruffini_tests --gtest_brief=1 --gtest_filter='*$(PASCAL)*'
	@$(BUILD)/ruffini_device_tests --gtest_brief=1 --gtest_filter='*$(PASCAL)*'
	@$(PYTEST) -k '$(ONLY)' tests/bitexact tests/py || [ $$? -eq 5 ]  # 5: no test in Python
else
test: build
	@.ci/setup browser
	@memory=$$(.ci/memory-folder); [ -z "$$memory" ] || export TMPDIR=$$memory TEST_TMPDIR=$$memory/; \
	  set -m; .ci/ctest $(BUILD) $(JOBS) & cpp=$$!; { npm --prefix host/page --silent test < /dev/null > $(BUILD)/page.log 2>&1 || { echo "make: tests of the page FAILED, see $(BUILD)/page.log" >&2; false; }; } & page=$$!; set +m; failed=; \
	  trap 'kill -INT -- -$$cpp -$$page 2> /dev/null && wait $$cpp $$page || true; [ -z "$$memory" ] || rm -rf "$$memory"' EXIT; trap 'exit 130' INT TERM; \
	  $(PYTEST) tests || failed=1; wait $$page || failed=1; cat $(BUILD)/page.log; \
	  wait $$cpp || { failed=1; echo "make: C++ tests FAILED, see above" >&2; }; [ -z "$$failed" ]
endif

test-realtime: build  ## the few tests that are about real time, one after the other on a quiet computer; each states its margin, none is retried
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTHON) -m pytest -c host/pyproject.toml -m realtime -v -rs tests

# RUFFINI_READMES_TURN=0/2: the first, third, fifth... of them; 1/2: the others.
EXTRA_TESTS = tests/py/train tests/e2e/test_learned_network.py tests/e2e/test_recordings.py tests/e2e/test_rerun.py
readmes: build  ## the commands of all texts that need no board and take minutes, word for word; what takes hours with --quick and the tests of what needs the extras (6 GB)
	@.ci/setup browser
	@.ci/setup extras
	@$(PYTHON) -m pytest -c host/pyproject.toml -n $(JOBS) -rs $(EXTRA_TESTS)
	@$(PYTHON) -m pytest -c host/pyproject.toml -n $(JOBS) -m long -vv --durations 0 tests/e2e/test_long_commands.py tests/e2e/test_auto_boards.py tests/e2e/test_bench_file.py \
	  tests/e2e/test_demo_boards.py tests/e2e/test_readme_blocks.py tests/e2e/test_view_calibration.py

lint: lint-docs lint-python lint-page lint-cpp werror  ## spelling, formatters, linters, types, and a build where warnings are errors

docs: build  ## the documentation as a static site in build/docs/site: links and anchors checked, opens from the file system
	@$(PYTHON) docs/build_site.py $(BUILD)/docs

lint-docs: setup  ## spelling of the texts and comments
	@git ls-files -z '*.md' '*.py' '*.h' '*.cpp' '*.proto' '*.toml' '*.ts' Makefile CMakeLists.txt | xargs -0 .venv/bin/codespell --ignore-words docs/vocabulary.txt

lint-python: setup  ## ruff, mypy --strict, and that nothing is newer than Python 3.10
	@$(PYTHON) -m ruff check --config host/pyproject.toml host tests docs
	@$(PYTHON) -m ruff format --check --config host/pyproject.toml host tests docs
	@$(PYTHON) -m mypy --config-file host/pyproject.toml host/ruffini host/papers
	@.venv/bin/vermin --quiet --no-tips --eval-annotations -t=3.10- host/ruffini host/papers host/examples

lint-page: build  ## types of the page, strict
	@npm --prefix host/page --silent run check

lint-format: setup  ## clang-format on all C++
	@git ls-files '*.cpp' '*.h' | xargs .venv/bin/clang-format --dry-run -Werror

# ANALYZE=I/N: the analyzer, half of clang-tidy's time, only on every N-th file, from number I; all other checks on all files.
ANALYZE ?= 0/1
lint-cpp: build lint-format  ## clang-tidy on the core
	@.ci/setup lint
	@git ls-files 'firmware/image/*.cpp' 'firmware/solve/*.cpp' 'firmware/core/*.cpp' 'firmware/estimators/*.cpp' 'firmware/stages/*.cpp' firmware/frame_calibration.cpp firmware/frame_path.cpp \
	  firmware/link/frame_codec.cpp firmware/link/dense_codec.cpp firmware/store/calibration.cpp \
	  | awk -v turn='$(ANALYZE)' '{split(turn, t, "/"); print "--checks=" (NR % t[2] == t[1] ? "" : "-clang-analyzer-*"), $$0}' \
  | while read -r checks file; do echo "$$(stat -c %s "$$file") $$checks $$file"; done | sort -rn | cut -d' ' -f2- \
	  | xargs -P $(JOBS) -n 2 clang-tidy -p $(BUILD) --quiet 2> >(grep -v 'warnings\? generated' >&2)

werror: setup  ## a build where warnings are errors
	@$(call compile,$(BUILD)$(if $(WERROR),,/werror),$(STRICT))

comma := ,
SANITIZE_FLAGS = -fno-omit-frame-pointer -fno-sanitize-recover=all
# -O1 with line tables compiles in half the time of -O2 -g; the core keeps its own -O2, the tests' own sources need none. What the optimizer folds away no sanitizer sees.
SANITIZED = -DCMAKE_CXX_FLAGS_RELWITHDEBINFO='-O1 -g1 -DNDEBUG' -DRUFFINI_TEST_OPTIONS=-O0
# One tree for the C++ tests and the fuzzers, which need clang; it compiles the checks in two thirds of GCC's time.
ASAN_FLAGS = -fsanitize=address$(comma)undefined$(comma)fuzzer-no-link $(SANITIZE_FLAGS)
ASAN = -DCMAKE_C_COMPILER=clang -DCMAKE_CXX_COMPILER=clang++ -DCMAKE_C_FLAGS='$(ASAN_FLAGS)' -DCMAKE_CXX_FLAGS='$(ASAN_FLAGS)' $(SANITIZED) -DRUFFINI_LIBFUZZER=ON
TSAN = -DCMAKE_CXX_FLAGS='-fsanitize=thread $(SANITIZE_FLAGS)' $(SANITIZED)
SHARDS := 0 1
sanitize: setup  ## C++ tests under ASan + UBSan, then those with threads under TSan
	@.ci/setup lint
	@$(call compile,$(BUILD)/clang,$(ASAN),ruffini_tests ruffini_device_tests ruffini_capture_tests)
	@$(call compile,$(BUILD)/tsan,$(TSAN),ruffini_thread_tests ruffini_two_cores_test)
	@.ci/at-once $(JOBS) \
	  $(foreach i,$(SHARDS),'RUFFINI_CRASH_STEP=64 GTEST_TOTAL_SHARDS=2 GTEST_SHARD_INDEX=$(i) $(BUILD)/clang/ruffini_device_tests --gtest_brief=1') \
	  $(foreach i,$(SHARDS),'GTEST_TOTAL_SHARDS=2 GTEST_SHARD_INDEX=$(i) $(BUILD)/clang/ruffini_tests --gtest_brief=1') \
	  '$(BUILD)/tsan/ruffini_two_cores_test --gtest_brief=1' \
	  '$(BUILD)/tsan/ruffini_thread_tests --gtest_brief=1' \
	  'ASAN_OPTIONS=detect_leaks=0 LD_LIBRARY_PATH=$(BUILD)/clang $(BUILD)/clang/ruffini_capture_tests --gtest_brief=1'  # dlopen under ASan heeds no RUNPATH

MUTATIONS ?= 1000000
fuzz: build  ## hostile bytes under ASan + UBSan: MUTATIONS messages to the session and to both sides' decoders, FUZZ_S seconds for each parser; LEDGER=1 counts them
	@.ci/setup lint
	@$(call compile,$(BUILD)/clang,$(ASAN),ruffini_fuzz_session ruffini_fuzz_targets)
	@.ci/at-once $(JOBS) '$(BUILD)/clang/ruffini_fuzz_session proto/vectors/frames.txt $(MUTATIONS)' '$(PYTHON) tests/fuzz/differential.py $(MUTATIONS)'
	@LEDGER='$(LEDGER)' .ci/fuzz-parsers $(BUILD) $(FUZZ_S) $(FUZZ_FAST_S)

coverage: build  ## branches of framing, session, store and fixed point that their tests take, with a floor for each file
	@.ci/setup lint
	@.ci/coverage $(BUILD)

SIM_HOURS ?= 100
# The last six digits of the first seed; each job has its own before them.
SIM_FIRST ?= 000001
simulate: build  ## SIM_HOURS device-hours of device, host, line, camera and medium with faults, simulated
	@seq $(JOBS) | xargs -P $(JOBS) -I {} $(BUILD)/ruffini_simulation --hours $$((($(SIM_HOURS) + $(JOBS) - 1) / $(JOBS))) --first {}$(SIM_FIRST)

soak: build  ## the long runs of what `make test` does in short: every crash state, power cut and spoilt bit of the calibration store, a million frames, broken lines
	@RUFFINI_CRASH_STEP=1 $(BUILD)/ruffini_device_tests --gtest_filter='CrashStates.*'
	@RUFFINI_SOAK=1 $(BUILD)/ruffini_store_faults_test --gtest_brief=1
	@RUFFINI_SOAK=1 $(BUILD)/ruffini_device_tests --gtest_filter='Signature.*' --gtest_brief=1
	@RUFFINI_SOAK=1 $(BUILD)/ruffini_frame_loop_test --gtest_brief=1
	@RUFFINI_SOAK=1 $(PYTHON) -m pytest -c host/pyproject.toml -q -s tests/e2e/test_broken_line.py
	@$(PYTHON) tests/ledger.py simulation $(BUILD)/ruffini_simulation $(SIM_HOURS)

mutants: build  ## seeded bugs in firmware, host and page: each must be seen by its layer of tests; TURN=I/N plays each N-th
	@$(PYTHON) tests/mutants/mutants.py --build $(BUILD) $(if $(TURN),--turn $(TURN)) --tests-that-never-caught $(BUILD)/idle_tests.txt

HOSTILE ?=
hostile: build  ## own hostile cases, SIMULATED: camera faults and more; writes docs/results/hostile.md. HOSTILE='--quick --only pictures'
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTHON) tests/hostile/hostile.py --table docs/results/hostile.md $(HOSTILE)

GELS ?=
gels: build  ## force of gels without markers by `ruffini cal auto`, SIMULATED; writes their rows in docs/results/accuracy.md. GELS='--board ninedtact'
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTHON) tests/bench/gels.py --table docs/results/accuracy.md $(GELS)
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTHON) tests/bench/new_unit.py --out out/new_unit --table docs/results/accuracy.md

resolution: build  ## lines told apart and response by spatial frequency of every force field, SIMULATED; writes its rows in docs/results/accuracy.md and its picture
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTHON) tests/bench/resolution.py --table docs/results/accuracy.md --out docs/results/resolution.png

steady: build  ## noise of the field of held contacts, of single frames and of means, SIMULATED; writes its row in docs/results/accuracy.md
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTHON) tests/bench/steady.py --table docs/results/accuracy.md

DATA ?= $(RUFFINI_RECORDED_DATA)
real: build  ## one table and a page of what was measured on recordings of real sensors in DATA=FOLDER, with peers on the same rows
	@.venv/bin/ruffini eval real $(DATA) --out out/real.html --table out/real.md

bench: setup  ## time of every stage with peers beside them; accuracy on simulated presses; QUICK=1 smaller, not the README's figures
	@$(call compile,$(BUILD),-DRUFFINI_BENCH=ON)
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTHON) tests/bench/benchmarks.py --build $(BUILD)
	@$(PYTHON) tests/bench/two_cores.py --build $(BUILD)
	@$(PYTHON) tests/bench/line_time.py $(if $(QUICK),--frames 600)
	@$(PYTHON) tests/bench/client_decode.py --build $(BUILD)
	@$(PYTHON) tests/bench/scaling.py --build $(BUILD) $(if $(QUICK),--quick)
	@$(PYTHON) tests/bench/building.py $(if $(QUICK),--quick)
	@$(PYTHON) tests/bench/accuracy.py $(if $(QUICK),--pads 1 --presses 6)
	@$(PYTHON) tests/bench/twin.py $(if $(QUICK),--quick)
	@$(if $(QUICK),true,$(PYTHON) tests/bench/residual.py)

ORACLE = OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 nice $(PYTHON) tests/oracle/oracle.py
oracle: build  ## CalculiX, a finite element program of others, presses the pad that the board measures: one press now, the others as kept; TURN=K/16: every 16th, from the K-th; TURN=0/1: all, hours
	@.ci/setup oracle
	@$(ORACLE) --again --turn $(or $(TURN),3/16) $(if $(TURN),,--twin)
	@$(if $(TURN),true,$(ORACLE) --out out/oracle.txt)

FUNCTIONS ?= 0
profile: build  ## instructions, loads and cache lines of every stage on 64-bit ARM, counted under qemu: the same on any machine with one compiler; writes its rows in docs/results/accuracy.md. FUNCTIONS=N: the N longest functions of each
	@.ci/setup aarch64
	@$(call compile,$(BUILD)/aarch64,-DCMAKE_TOOLCHAIN_FILE=.ci/aarch64.cmake -DRUFFINI_DAEMON=OFF,ruffini_one_frame)
	@$(PYTHON) tests/bench/instructions.py --binary $(BUILD)/aarch64/ruffini_one_frame --functions $(FUNCTIONS) --table docs/results/accuracy.md

# Of the Pi Zero 2 and 3, of the 4, of the 5; CI runs one of them a day.
PI_CORES := cortex-a53 cortex-a72 cortex-a76
aarch64: build  ## the core and its tests cross-compiled for 64-bit ARM, run under qemu as a Pi 3, 4 and 5's core
	@.ci/setup aarch64
	@$(call compile,$(BUILD)/aarch64,-DCMAKE_TOOLCHAIN_FILE=.ci/aarch64.cmake -DRUFFINI_DAEMON=OFF -DRUFFINI_TEST_OPTIONS=-O1,ruffini_tests)
	@.ci/at-once $(JOBS) $(foreach core,$(PI_CORES),$(foreach i,0 1 2 3,'echo $(core); GTEST_TOTAL_SHARDS=4 GTEST_SHARD_INDEX=$(i) \
	  qemu-aarch64 -cpu $(core) -L /usr/aarch64-linux-gnu $(BUILD)/aarch64/ruffini_tests --gtest_brief=1'))

wheel: setup  ## the host tool as a wheel for this machine's kind of Linux, glibc 2.31 or newer
	@CMAKE_BUILD_PARALLEL_LEVEL=$(JOBS) .ci/wheel

wheels: build  ## wheels for x86_64 and aarch64, installed and started in bare roots of Debian 11, 12 and 13 and under QEMU (needs root, 4 GB)
	@.ci/setup vm
	@CMAKE_BUILD_PARALLEL_LEVEL=$(JOBS) .ci/wheels

deb: build  ## Debian packages of device, library and host tool, built in a Debian 13 root, installed and started in another (needs root, 5 GB)
	@.ci/setup vm
	@.ci/deb $(JOBS)

arm64: build  ## packages for 64-bit ARM, cross-built, installed beside what they need and started under QEMU (needs root, 8 GB)
	@.ci/setup vm
	@.ci/arm64 $(JOBS)

vm: build  ## a virtual board: the packages under systemd on a real kernel's GPIO, I2C, USB gadget and camera interfaces (needs root, 6 GB)
	@.ci/setup vm
	@.ci/deb $(JOBS)
	@.ci/vm

pi: build  ## an emulated Raspberry Pi after `make arm64` and `make wheels`: ruffinid and the host tool on its I2C and GPIO drivers (needs root, 9 GB)
	@.ci/setup vm
	@.ci/pi

board: build  ## deb, arm64, wheels, pi and vm in one, the packages side by side (needs root, 12 GB)
	@.ci/setup vm
	@.ci/board $(JOBS)

NEW ?=
version:  ## NEW=X.Y.Z: that version in every file that states it
	@.ci/release version '$(NEW)'

release: setup  ## from a tagged commit: wheels, packages, source archive and checksums in build/release (needs root, 13 GB)
	@.ci/release make

fresh:  ## the README's commands in a clean root: SUITE=bookworm|trixie (needs root and debootstrap)
	@.ci/fresh '$(SUITE)'

clean:  ## remove what was built (not .venv)
	@rm -rf $(BUILD) out

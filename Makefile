# The two commands of the README, and what developers add. Everything lives in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SECONDS ?= 60
TARGET ?= all
RUNS ?= 1000000

.PHONY: install demo test check bench fuzz faults coverage evaluate peers system-test clean lock

install: $(VENV)/.installed          ## .venv with amr-slam in it, as robots get it

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "amr-slam needs Python 3.11 or newer; try: make PYTHON=python3.12" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: requirements.lock pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	$(BIN)/python -m amr_slam.warming
	@touch $@

$(VENV)/.dev: requirements-dev.lock $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.lock
	@touch $@

demo: install                        ## the main job with no hardware: make demo SECONDS=60
	$(BIN)/python tools/demo.py --seconds $(SECONDS)

test: $(VENV)/.dev                   ## the whole test suite
	$(BIN)/python -m pytest -n 2 --dist worksteal $(ARGS)

check: $(VENV)/.dev                  ## style, types, layers
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/.dev                  ## what is measured: side by side, never asserted
	$(BIN)/python benchmarks/run.py
	$(BIN)/python benchmarks/scanners.py
	$(BIN)/python benchmarks/latency.py

$(VENV)/.fuzz: requirements-fuzz.lock $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-fuzz.lock
	@touch $@

fuzz: $(VENV)/.fuzz                  ## parsers against odd bytes: make fuzz TARGET=s300_stream RUNS=10000000
	$(BIN)/python tools/fuzz.py $(TARGET) --runs $(RUNS) $(ARGS)

faults: $(VENV)/.dev                 ## docs/reliability.md anew: every fault on a whole robot, 20 minutes
	$(BIN)/python tools/faults.py $(ARGS) --out docs/reliability.md

coverage: $(VENV)/.dev               ## branch coverage of the whole suite, with the processes that it starts
	-$(BIN)/python -m pytest -n 2 --dist worksteal --cov --cov-report= -o timeout=600 $(ARGS)
	$(BIN)/python tools/covered.py --write

$(VENV)/.peers: requirements-peers.lock $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-peers.lock
	@touch $@

peers: $(VENV)/.peers                ## other registration libraries, for evaluate to compare with

evaluate: $(VENV)/.dev               ## docs/evaluation.md anew: make evaluate LOGS=folder ARGS="--scale 0.1"
	$(BIN)/python tools/evaluate.py $(if $(LOGS),--logs $(LOGS)) $(ARGS)

system-test: $(VENV)/.dev            ## a whole computer in qemu, mistreated (docs/system-test.md; as root)
	@for program in qemu-system-x86_64 qemu-img mmdebstrap modprobe cpio debugfs busybox; do \
	  command -v $$program >/dev/null || exec sh -c 'apt-get update -q && apt-get install -q -y --no-install-recommends \
	    qemu-system-x86 qemu-utils mmdebstrap kmod cpio e2fsprogs busybox-static'; \
	done
	PYTHONPATH=tests $(BIN)/python -m system $(ARGS)

lock: $(VENV)/.dev                   ## renew the pinned versions (needs uv)
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --no-strip-extras \
	  --no-emit-index-url --quiet pyproject.toml requirements-build.in -o requirements.lock
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --no-strip-extras \
	  --no-emit-index-url --quiet -c requirements.lock --group dev pyproject.toml -o requirements-dev.lock
	for group in peers fuzz; do \
	  uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --no-strip-extras \
	    --no-emit-index-url --quiet -c requirements-dev.lock --group $$group -o requirements-$$group.lock || exit 1; \
	done

clean:
	rm -rf $(VENV) build out *.egg-info

# Every target makes .venv by itself; `make demo` and `make test` each take a fresh machine to their end.
VENV := .venv
BIN := $(VENV)/bin
PYTHON := $(shell for p in python3.12 python3.13 python3.14 python3; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 12))' >/dev/null 2>&1 && echo $$p && break; done)
NEED_PYTHON = test -n "$(PYTHON)" || { echo "poseterior needs Python 3.12 or newer on the PATH (as python3.12 or python3); install one and run make again." >&2; exit 2; }
# Where bytecode is not written (as in many containers) every process would compile all libraries anew.
export PYTHONDONTWRITEBYTECODE :=
# One thread of BLAS and OpenMP a process: the tests already run one process a core, and threads that
# wait for a core that another process has make them six times slower.
PYTEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --durations=25

.PHONY: demo test test-all sweeps lint bench docs notebooks dist fuzz mutants drawn-mutants kills conditions lock clean

demo: $(VENV)/.done
	$(BIN)/poseterior demo

# Compiled without optimisation: most of what these tests wait for is XLA's compiler. A file of tests
# stays in one process, where its programs are traced and its fixtures made once.
test: $(VENV)/.done
	XLA_FLAGS=--xla_backend_optimization_level=0 $(PYTEST) --dist loadfile -m "not slow and not sweep"

test-all: $(VENV)/.done
	$(PYTEST) --dist worksteal -m "slow and not sweep"

# Minutes a test: wrong samplers on the benchmark, external ones, kills, the commands of the how-to pages.
sweeps: $(VENV)/.done
	$(PYTEST) --dist worksteal -m sweep

lint: $(VENV)/.done
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m tests.notebooks check

bench: $(VENV)/.done
	$(BIN)/python -m pytest tests/benchmarks --benchmark-only
	$(BIN)/python -m poseterior.reports.pages.speed

# The site, in build/site: a warning, or a link that leads nowhere, ends it.
docs: $(VENV)/.done
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet -c docs . build/site

# Executes the notebooks whose outputs are stale (or all: make notebooks WHICH=all), and stores what they show.
notebooks: $(VENV)/.done
	$(BIN)/python -m tests.notebooks $(WHICH)

# Wheel and sdist, the wheel built from the sdist, and tried where nothing else of ours is.
dist:
	@$(NEED_PYTHON)
	rm -rf dist build
	$(PYTHON) -m venv build/maker
	build/maker/bin/python -m pip install --quiet --disable-pip-version-check build
	build/maker/bin/python -m build --outdir dist .
	$(PYTHON) -m venv build/clean
	build/clean/bin/python -m pip install --quiet --disable-pip-version-check dist/*.whl
	mkdir build/elsewhere
	cd build/elsewhere && ../clean/bin/python -P ../../tests/installed.py

# What is installed is what the lock's hashes say, its own builder too. It is not compiled to bytecode at
# once: most of it is never imported, and that takes a sixth of the time.
$(VENV)/.done: pyproject.toml requirements.lock
	@$(NEED_PYTHON)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --no-deps --require-hashes --requirement requirements.lock
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --disable-pip-version-check --editable .
	@echo "compiling the loops, once"
	@$(BIN)/poseterior demo --quiet --out $(VENV)/demo > /dev/null
	@$(BIN)/poseterior hypotheses examples/skier.json --quiet --out $(VENV)/skier > /dev/null
	@touch $@

# FUZZ_CASES or FUZZ_SECONDS says how much, FUZZ_SEED which.
fuzz: $(VENV)/.done
	$(BIN)/python -m tests.fuzzing

# MUTANTS_NAMES=root,alias says which faults, MUTANTS_SECONDS how long.
mutants: $(VENV)/.done
	$(BIN)/python -m tests.mutants

# Faults by cosmic-ray: MUTANTS_NUMBER says how many (or MUTANTS_SECONDS how long), MUTANTS_SEED which,
# MUTANTS_NAMES in which files, MUTANTS_SLOW=1 that slow tests see what quick ones do not, MUTANTS_EARLIER
# a commit whose tests are counted apart.
drawn-mutants: $(VENV)/.done
	$(BIN)/python -m tests.mutants.drawn

# KILLS says how many of each command (or KILLS_SECONDS how long in all), KILLS_SEED which.
kills: $(VENV)/.done
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.kills

# The quick tests as other machines would run them: other processors, orders, cores, loads.
conditions: $(VENV)/.done
	$(BIN)/python -m tests.conditions

# The versions that stand in the lock are kept while they fit pyproject.toml; LOCK=--upgrade takes the newest.
lock:
	@$(NEED_PYTHON)
	$(PYTHON) -m venv build/locker
	build/locker/bin/python -m pip install --quiet --disable-pip-version-check uv
	build/locker/bin/uv pip compile pyproject.toml $(LOCK) --extra dev --extra docs --extra mutation --universal \
		--python-version 3.12 --generate-hashes --no-annotate --quiet --custom-compile-command "make lock" \
		--output-file requirements.lock > /dev/null

clean:
	rm -rf $(VENV) build dist .pytest_cache .ruff_cache .mypy_cache

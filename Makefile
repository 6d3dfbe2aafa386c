# Everything a person or a machine does with this repository; needs Python 3.11 or later with venv, and make.
PYTHON ?= python3
VENV ?= .venv
PY = $(VENV)/bin/python
PIP_INSTALL = $(PY) -m pip install --quiet --disable-pip-version-check --no-input
OUT ?= sessions
SEED ?= 1
N ?= 10000
BASE ?= 8ff4cd9

# One thread for the linear algebra, as `bench` itself sets it: small matrices, results that do not depend on the cores.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
# Hundreds of processes are started by the tests: they read compiled modules, whatever the machine says.
export PYTHONDONTWRITEBYTECODE =

.PHONY: demo test mutants survivors definitions sweep faults doubt published coverage soak losses archive-drill deviations compare notebooks pictures situations site figures ways validate public bench lint wheel lock

demo: $(VENV)/.run
	$(VENV)/bin/bench run sequences/scale_factor_38h.yaml --clock virtual --seed $(SEED) --out $(OUT) --truth
	@echo "Report: $$(ls -t $(OUT)/*/report.html | head -n 1)"

# Four workers on two cores: two begin with the tests that wait for real time, of terminals, browsers and killed
# processes, two with those that compute (tests/support/two_ends.py).
test: $(VENV)/.dev $(VENV)/.broker
	$(PY) -m pytest -n 4 --dist loadfile -m "not sweep"

mutants: $(VENV)/.dev
	$(PY) tests/mutants/run.py

# Mutants of a ROOM drawn by SEED, N of them, against the tests nearest to them; rows in tests/mutants/survivors.csv.
ROOM ?= bench/maths
survivors: N = 20
survivors: $(VENV)/.mutation
	$(PY) tests/mutants/survivors.py $(ROOM) --seed $(SEED) --count $(N)

definitions: $(VENV)/.dev
	$(PY) -m pytest -n 2 --dist worksteal -rP -m sweep tests/fuzz/test_random_definitions.py

sweep: $(VENV)/.dev
	$(PY) -m pytest -n 2 -m sweep

faults: $(VENV)/.dev
	$(PY) -m pytest -n 2 --dist worksteal -rP -m sweep tests/fault

# Wrong worlds of all systems and 500 right ones of each; what stands in tests/doubt/rows.csv is not done again.
doubt: $(VENV)/.dev
	$(PY) tests/doubt/run.py

# Right worlds of all published sequences, seeds 1 to 20; what is recorded below the folder KEEP is fitted again.
KEEP ?= sessions/published
published: $(VENV)/.dev
	$(PY) tests/doubt/published.py $(KEEP)

# Intervals against the truth, 2,000 campaigns of each kind, or of one by SYSTEMS=standards; what stands in
# tests/coverage/rows.csv is not done again.
coverage: $(VENV)/.dev
	$(PY) tests/coverage/run.py $(SYSTEMS)

# N seeds in all, 10,000 of the short campaign or CAMPAIGN=scale_factor_38h N=10; what stands in tests/soak/blocks.csv is
# not done again, so it can be stopped at any time.
soak: $(VENV)/.dev
	$(PY) tests/soak/run.py $(N) $(CAMPAIGN)

# 200 losses of the network, up to five minutes and for good, six benches side by side (tests/fault/matrix.md); what stands in
# tests/fault/losses.csv is not done again. WORDS: of tests/support/losses/loss_drill.py, for example --count 20.
losses: $(VENV)/.dev
	$(PY) tests/support/losses/loss_drill.py $(WORDS)

# N sessions of years (docs/history.md), refitted here, on one worker and on two: the same bytes, and exactly the
# certificates that a wrong standard concerns. What is recorded in build/archive-drill is not recorded again.
archive-drill: $(VENV)/.dev
	$(PY) -m benchmarks.archive $(N)

# 500 hours of chambers that overshoot, cycle and have their doors opened: at most one false warning (docs/unattended.md).
deviations: $(VENV)/.dev
	$(PY) -m pytest -q -n 0 -rP -m sweep tests/unit/run/watch/test_deviations.py

# Every analysis in an earlier revision and in this one, side by side (docs/history.md).
compare: $(VENV)/.dev
	$(PY) tests/comparison --base $(BASE)

# Twelve situations on every page, as pictures to look at; needs Chromium.
situations: $(VENV)/.dev
	BENCH_SCREENSHOTS=build/situations $(PY) -m pytest -q -n 0 tests/browser/test_situations.py

# The pictures of the README, from a real run; needs Chromium.
pictures: $(VENV)/.dev
	PYTHONPATH=tests/support/page $(PY) docs/pictures/draw.py

# The site of documentation in build/site/html; notebooks are executed, any warning fails.
site: $(VENV)/.docs
	$(PY) docs/site/build.py

# What the notebooks show, again; 'make site' executes them without keeping it.
notebooks: $(VENV)/.docs
	$(PY) docs/site/notebooks.py

# Figures of weight, beside the last row of benchmarks/record.md; tests/house/test_ratchets.py holds them down.
figures: $(VENV)/.run
	$(PY) tests/house/figures.py

# The files that a frame and a step pass (docs/architecture.md).
ways: $(VENV)/.run
	$(PY) tests/house/ways.py

validate: $(VENV)/.dev
	PYTHONPATH=tests $(PY) -m pytest -q -p validation_record --validation-record tests/validation.md

# The wires and logs of other people in tests/validation.md, read again: FROM=FOLDER with their files.
public: $(VENV)/.dev
	PYTHONPATH=tests:. $(PY) tests/public_captures.py $(FROM)

bench: $(VENV)/.benchmark
	$(PY) -m benchmarks

lint: $(VENV)/.dev
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy
	$(VENV)/bin/lint-imports

wheel: $(VENV)/.build
	rm -rf build/lib build/bdist.* dist
	$(PY) -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir dist .

# The locks: hashed, without the address of any index. Run it after a change of the dependencies in pyproject.toml.
COMPILE = CUSTOM_COMPILE_COMMAND="make lock" $(PY) -m piptools compile --quiet --generate-hashes --strip-extras \
	--allow-unsafe --no-emit-index-url --no-emit-find-links --no-emit-trusted-host
RUN = --extra report --extra history --extra page --extra terminal
lock: $(PY)
	$(PIP_INSTALL) pip-tools
	$(COMPILE) --output-file requirements/build.txt requirements/build.in
	$(COMPILE) --output-file requirements/broker.txt requirements/broker.in
	$(COMPILE) $(RUN) --output-file requirements/run.txt pyproject.toml
	$(COMPILE) --constraint requirements/run.txt $(RUN) --extra dev --output-file requirements/dev.txt pyproject.toml
	$(COMPILE) --constraint requirements/run.txt --constraint requirements/dev.txt $(RUN) --extra docs --output-file requirements/docs.txt pyproject.toml
	$(COMPILE) --constraint requirements/run.txt $(RUN) --extra benchmark --output-file requirements/benchmark.txt pyproject.toml
	$(COMPILE) --constraint requirements/run.txt --constraint requirements/dev.txt $(RUN) --extra mutation --output-file requirements/mutation.txt pyproject.toml

$(PY):
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or later is needed, this is " + sys.version) if sys.version_info < (3, 11) else None'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.build: requirements/build.txt | $(PY)
	$(PIP_INSTALL) --require-hashes -r requirements/build.txt
	@touch $@

$(VENV)/.run: requirements/run.txt pyproject.toml | $(VENV)/.build
	$(PIP_INSTALL) --require-hashes -r requirements/run.txt
	$(PIP_INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.dev: requirements/dev.txt $(VENV)/.run
	$(PIP_INSTALL) --require-hashes -r requirements/dev.txt
	@touch $@

$(VENV)/.broker: requirements/broker.txt | $(PY)
	$(PYTHON) -m venv $(VENV)/broker
	$(VENV)/broker/bin/python -m pip install --quiet --disable-pip-version-check --no-input --require-hashes -r requirements/broker.txt
	@touch $@

$(VENV)/.docs: requirements/docs.txt $(VENV)/.dev
	$(PIP_INSTALL) --require-hashes -r requirements/docs.txt
	@touch $@

$(VENV)/.benchmark: requirements/benchmark.txt $(VENV)/.run
	$(PIP_INSTALL) --require-hashes -r requirements/benchmark.txt
	@touch $@

$(VENV)/.mutation: requirements/mutation.txt $(VENV)/.dev
	$(PIP_INSTALL) --require-hashes -r requirements/mutation.txt
	@touch $@

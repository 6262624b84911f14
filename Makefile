# Every target sets up what it needs first; `make help` lists them.
.DEFAULT_GOAL := help
# The dearest come first, so that no core waits for one in the end.
DEAREST := test_rig_faults test_state_models test_shipped_previews \
	test_rendered_degrees test_skin_states test_preview_model test_readers
VALIDATIONS := $(DEAREST) $(filter-out $(DEAREST), \
	$(basename $(notdir $(wildcard tests/validation/test_*.py))))
.PHONY: help explore verify train test unit slow docs validation validation-long scoreboard \
	scoreboard-long benchmark lint format check-format types clean $(VALIDATIONS)

SCENE ?= finger20
DESIGN ?= $(error name the design, for example: make verify DESIGN=runs/finger20-explore/design.json)
BIN := .venv/bin
BASE := .venv/base.stamp
FULL := .venv/full.stamp
SETUP := pyproject.toml .ci/setup .ci/constraints.txt examples/javascript/package-lock.json
SOURCES := tactilux.py render surrogate optimize hw tests examples docs
export PYTHON

help: ## List the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

explore: $(BASE) ## Find a better lighting design for SCENE (finger20) in about a minute
	$(BIN)/tactilux explore $(SCENE)

verify: $(FULL) ## Prove DESIGN against the baseline by physically based rendering
	$(BIN)/tactilux verify $(DESIGN)

train: $(FULL) ## Render the training cells of SCENE and fit its surrogate (about an hour)
	$(BIN)/tactilux train $(SCENE)

test: lint check-format types unit ## Before every commit; CI adds validation and benchmarks

# Two workers on two cores: more threads of BLAS than cores wait for each other, five times as long.
unit slow: export OMP_NUM_THREADS = 1
TESTS := $(BIN)/python -m pytest --numprocesses 2 --dist loadfile --ignore tests/benchmarks \
	--ignore tests/validation

unit: $(FULL) ## The tests alone, but for the slow ones
	$(TESTS) -m "not slow"

slow: $(FULL) ## Tests and whole journeys of many seconds each: part of `make validation`
	$(TESTS) -m slow

docs: export NO_MKDOCS_2_WARNING = 1
docs: $(FULL) ## The documentation as one site, opens from a folder: build/site/index.html
	$(BIN)/python -m mkdocs build --quiet --strict

# Validations leave a core idle each: two at a time.
validation: $(FULL) ## Slow tests; other renderers, closed forms and slow exact code
	$(MAKE) slow
	$(MAKE) --jobs 2 --output-sync $(VALIDATIONS)

# A process each, so that one can be run by its name.
$(VALIDATIONS): export OMP_NUM_THREADS = 1
$(VALIDATIONS): $(FULL)
	$(BIN)/python -m pytest tests/validation/$@.py

# Each file's words stay in a folder, and so does the list of its tests that passed: none of them
# runs again until a source changes, and hours that are stopped go on. The dearest comes first, so
# that no core waits for it in the end.
LONG := build/validation-long
LONGEST := $(LONG)/test_clear_pads.txt
LONG_RUNS := $(LONGEST) \
	$(filter-out $(LONGEST),$(VALIDATIONS:%=$(LONG)/%.txt) $(LONG)/nights.txt)
CODE := $(shell git ls-files '*.py' '*.toml' '*.glsl' '*.npz' '*.onnx')
NIGHTS := $(addprefix tests/optimize/overnight/test_,kills.py power_cuts.py simulated_nights.py \
	whole_night.py progress.py states.py)
KEPT = set -o pipefail; $(BIN)/python -m pytest --capture no --passed $(@:.txt=.passed) $(1) 2>&1 \
	| tee --append $@.part; mv $@.part $@

validation-long: export TACTILUX_LONG = 1
validation-long: $(FULL) ## More samples and more cases (hours), goes on where it stopped
	$(MAKE) slow
	$(MAKE) --jobs 2 --keep-going --output-sync $(LONG_RUNS)

$(LONG_RUNS): SHELL := /bin/bash -e
$(LONG_RUNS): export OMP_NUM_THREADS = 1
$(LONG_RUNS): export TACTILUX_LONG = 1
$(LONG)/nights.txt: $(LONG)/nights.passed
	$(call KEPT,$(NIGHTS))

$(LONG)/%.txt: $(LONG)/%.passed
	$(call KEPT,tests/validation/$*.py)

.PRECIOUS: $(LONG)/%.passed
$(LONG)/%.passed: $(CODE) $(FULL)
	@mkdir -p $(LONG); rm -f $(@:.passed=.txt.part); : > $@

scoreboard scoreboard-long: export OMP_NUM_THREADS = 1
scoreboard: $(FULL) ## Every level on some scenes against photons, and against what is on record
	$(BIN)/python -m tests.validation.scoreboard

scoreboard-long: export TACTILUX_LONG = 1
scoreboard-long: $(FULL) ## All scenes with more samples (hours), goes on where it stopped
	$(BIN)/python -m tests.validation.scoreboard

benchmark: $(FULL) ## The bounds on speed, alone on the machine, as ratios
	$(BIN)/python -m pytest --capture no tests/benchmarks

lint: $(FULL) ## Lint
	$(BIN)/ruff check $(SOURCES)

format: $(FULL) ## Rewrite the sources in the house format
	$(BIN)/ruff format $(SOURCES)
	$(BIN)/ruff check --fix $(SOURCES)

check-format: $(FULL) ## Whether `make format` would change anything
	$(BIN)/ruff format --check $(SOURCES)

types: $(FULL) ## Strict types
	$(BIN)/mypy

clean: ## Remove the environment and all caches, keep runs and models
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis build dist *.egg-info \
		examples/javascript/node_modules
	find $(SOURCES) -name __pycache__ -prune -exec rm -rf {} +

$(BASE): $(SETUP)
	@.ci/setup base

$(FULL): $(SETUP)
	@.ci/setup full

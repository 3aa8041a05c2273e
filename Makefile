# `make help` tells what there is. All of it happens in .venv, which is made and kept up to date.
SHELL := /bin/bash
MAKEFLAGS += --no-builtin-rules
.DEFAULT_GOAL := help
.PHONY: help demo test test-all fuzz lint docs speed appliances env clean package libraries

PYTHON ?= python3
N ?= 100
MINUTES ?= 60
export PYTHON
VENV := .venv
PY := $(CURDIR)/$(VENV)/bin/python
# The tests of one file share a process; ARGS="-n 0" runs all in one, as a debugger needs.
PYTEST := GCBENCH_TEST_INSTALLED=1 $(PY) -m pytest -rfEs -n auto --maxprocesses 8 --dist loadfile

# A stamp carries the hash of what it stands for, so that edits, deletions and checkouts count.
hash = $(shell sha256sum $(1) | sha256sum | cut -c -12)
SOURCES := $(filter-out %.pyc,$(wildcard *.py py.typed README.md LICENSE \
	$(foreach room,robots renderer gcpose benchmark,$(room)/*.* $(room)/*/*.* $(room)/*/*/*.* \
		$(room)/*/*/*/*.*)))
NEEDS := $(call hash,pyproject.toml .ci/environment)
PACKAGE := $(VENV)/.package-$(call hash,pyproject.toml $(SOURCES))

# An environment whose Python has gone, as after an upgrade, counts as none.
$(shell test -x $(PY) || rm -f $(VENV)/.base-*)

help:  ## this list
	@sed -n 's/^\([a-z-]*\):.*  ## /\1\t/p' $(MAKEFILE_LIST) | expand -t 10

demo: package  ## render a small UR5 dataset, verify it, show it, GC-Pose beside ICP, the leaderboard
	@.ci/system-libraries $(PY)
	@.ci/demo $(PY)

test: $(VENV)/.test-$(NEEDS) package libraries  ## the fast tests (a few minutes)
	$(PYTEST) -m "not slow and not ci" $(ARGS)

test-all: $(VENV)/.test-$(NEEDS) package libraries  ## all tests
	$(PYTEST) $(ARGS)

fuzz: package  ## hostile inputs of every kind for an hour (MINUTES); a finding is one line
	@.ci/system-libraries $(PY)
	$(PY) -m tests.fuzz --minutes $(MINUTES) $(ARGS)

lint: $(VENV)/.lint-$(NEEDS) package  ## ruff and pyright
	$(PY) -m ruff check .
	$(PY) -m pyright --pythonpath $(PY)

docs: $(VENV)/.docs-$(NEEDS) package  ## the documentation site in site/; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --strict
	@echo "$(CURDIR)/site/index.html"
	@echo "with search, at http://localhost:8000: python3 -m http.server -d $(CURDIR)/site"

speed: $(VENV)/.speed-$(NEEDS) package  ## frames per second, beside other ways to the same pixels
	@.ci/system-libraries $(PY)
	$(PY) tests/speed/render_speed.py $(ARGS)

appliances: package  ## render and verify a hundred of each appliance, with contact sheets (minutes)
	@.ci/system-libraries $(PY)
	for kind in microwave dishwasher oven drawer; do \
		$(PY) -m gcbench render --robot $$kind --n $(N) --frames 4 --width 320 --height 240 \
			--out demo/$$kind && \
		$(PY) -m gcbench verify demo/$$kind && \
		$(PY) -m gcbench show demo/$$kind --contact-sheet demo/$$kind.png || exit 1; \
	done

env: $(VENV)/.test-$(NEEDS) $(VENV)/.lint-$(NEEDS) package  ## the environment .venv, with gcbench installed

clean:  ## remove .venv and what was built and rendered here, but for data/
	rm -rf $(VENV) build dist site *.egg-info demo .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The package is installed as users get it, not editable: what is tested is what ships.
package: $(PACKAGE)

$(PACKAGE): $(VENV)/.base-$(NEEDS)
	$(PY) -m pip install --quiet --disable-pip-version-check --force-reinstall --no-deps \
		--no-build-isolation .
	@rm -f $(VENV)/.package-* && touch $@

$(VENV)/.base-$(NEEDS):
	.ci/environment $(VENV)
	@rm -f $(VENV)/.base-* && touch $@

$(VENV)/.%-$(NEEDS): $(VENV)/.base-$(NEEDS)
	.ci/environment $(VENV) $*
	@rm -f $(VENV)/.$*-* && touch $@

# A test of what this machine lacks is skipped and says so.
libraries: package
	@.ci/system-libraries $(PY) || true

# The three commands of the README. Each builds the environment first; nothing but Python 3.11 is needed before.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
CORES ?= 2
VENV := .venv
BIN := $(VENV)/bin
export PATH := $(CURDIR)/$(BIN):$(PATH)

.PHONY: all smoke test check clean

all: $(VENV)/installed
	snakemake all --cores $(CORES)

smoke: $(VENV)/installed
	snakemake all --configfile configs/smoke.yaml --cores $(CORES)

test: $(VENV)/installed check
	python -m pytest

# Formatter, linter and workflow linter: they change nothing.
check: $(VENV)/installed
	ruff format --check .
	ruff check .
	snakefmt --check Snakefile pipeline/rules
	snakemake --lint

# torch first: its pinned build must be there before another package asks for any torch.
$(VENV)/installed: requirements.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet "$$(grep '^torch==' requirements.txt)"
	$(BIN)/python -m pip install --quiet --requirement requirements.txt
	touch $@

clean:
	rm -rf $(VENV) results .snakemake

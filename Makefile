# The commands of the README. Each builds the environment first; nothing but Python 3.11 is needed before.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
CORES ?= 2
RUN ?= results/default
PORT ?= 8080
VENV := .venv
BIN := $(VENV)/bin
export PATH := $(CURDIR)/$(BIN):$(PATH)

.PHONY: all smoke app test check clean

all: $(VENV)/installed
	snakemake all --cores $(CORES)

smoke: $(VENV)/installed
	snakemake all --configfile configs/smoke.yaml --cores $(CORES)

# Shape garments by hand in a browser, with what `make all` learned: make app RUN=results/smoke PORT=9000
app: $(VENV)/installed
	python -m pipeline.app --run $(RUN) --port $(PORT)

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

"""One module a stage of the workflow, named like its rule; run as ``python -m pipeline.<stage>``."""

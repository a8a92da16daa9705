"""One module a stage of the workflow, named like its rule; run as ``python -m pipeline.<stage>``."""

from pipeline.start_up import before_imports

before_imports()

"""What every stage shares: its command line and one clear sentence for a user's mistake.

A stage is ``main(job)``. The job's ``spec`` is the canonical JSON of exactly what determines the outputs; it is the one
Snakemake parameter of the rule, so that a change of anything else never reruns the job. Device and threads say where
the work is done, not what comes out, and are kept apart from it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

from pipeline.start_up import after_imports, at_the_end


@dataclass(frozen=True)
class Job:
    """One run of a stage.

    Attributes:
        spec: What determines the outputs.
        inputs: Input files, in the order of the rule.
        outputs: Output files, in the order of the rule.
        device: ``auto``, ``cpu`` or ``cuda``.
        threads: CPU threads that the job may use.
    """

    spec: dict
    inputs: list[str]
    outputs: list[str]
    device: str
    threads: int


def run_stage(main: Callable[[Job], None]) -> None:
    """Parse the command line, run the stage, report time and memory.

    A wrong value or a file that is missing or cannot be read ends with exit code 1 and one sentence.
    """
    stage = os.path.basename(sys.argv[0]).removesuffix(".py")
    parser = argparse.ArgumentParser(prog=f"python -m pipeline.{stage}", description=sys.modules["__main__"].__doc__)
    parser.add_argument("--spec", required=True, help="canonical JSON that determines the outputs")
    parser.add_argument("--out", required=True, nargs="+", help="output files")
    parser.add_argument("--in", dest="inputs", default=[], nargs="*", help="input files")
    parser.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"], help="where to compute")
    parser.add_argument("--threads", type=int, default=1, help="CPU threads")
    options = parser.parse_args()
    after_imports()
    start = time.monotonic()
    try:
        main(Job(_parsed(options.spec), options.inputs, options.out, options.device, options.threads))
    except (ValueError, OSError) as error:
        if os.environ.get("DRAPELINE_TRACEBACK"):
            raise
        sys.exit(f"[{stage}] error: {error} (set DRAPELINE_TRACEBACK=1 for where it was raised)")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"[{stage}] done in {time.monotonic() - start:.1f} s, peak memory {peak:.2f} GB", file=sys.stderr, flush=True)
    at_the_end()


def _parsed(spec: str) -> dict:
    try:
        return json.loads(spec)
    except json.JSONDecodeError as error:
        raise ValueError(f"--spec is not JSON: {error}") from None

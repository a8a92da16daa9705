"""Stage ``compile_kernels``: compile the Warp kernels once, before parallel jobs would each do it.

In: nothing but the device. Out: a marker file; the compiled code lies in Warp's own cache.
"""

from __future__ import annotations

from pathlib import Path

from pipeline.stage import Job, run_stage
from sim.compile import compile_kernels


def main(job: Job) -> None:
    """Compile every kernel for the device."""
    compile_kernels(job.device)
    Path(job.outputs[0]).touch()


if __name__ == "__main__":
    run_stage(main)

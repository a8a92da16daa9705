"""Stage ``transfer_layer``: the simulations of one type of clothing as displacements of the body's vertices (Ma 2019).

In: the outfit's template on the run's own body, and its shard on sampled bodies. Out: a layer file with every n-th
frame, and a row of how much of the garment the body's topology loses, on one frame of every sequence.
"""

from __future__ import annotations

import numpy as np

from datasets.layers import LayerFile, write_layer
from evaluation.table import write_table
from garments.body_layer import BodyLayer, TransferError, cast_layer, transfer_error
from garments.template import GarmentTemplate
from pipeline.progress import Progress
from pipeline.sequence_data import job_bodies, job_body, job_sequences
from pipeline.stage import Job, run_stage

SHAPE = 10


def main(job: Job) -> None:
    """Transfer every sequence and write."""
    spec, own = job.spec, job_body(job)
    template = GarmentTemplate.load(job.inputs[0])
    layer, bodies = cast_layer(template, own), job_bodies(job)
    sequences = job_sequences(job, job.inputs[1:], plans=("bodies",))
    progress = Progress(f"transfer {spec['garment']}", len(sequences), "sequences")
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("displacements", "pose", "root", "shape")}
    numbers, errors, kept = [], [], []
    for sequence in sequences:
        frames = slice(None, None, spec["stride"])
        worn = BodyLayer(layer, bodies(sequence))
        cloth, pose, root = (getattr(sequence, name)[frames] for name in ("vertices", "pose", "root"))
        try:
            found = worn.displacements(cloth, pose, root)
        except ValueError as error:
            # One pose that cannot be undone costs its sequence, not the run.
            print(f"[transfer] left out {sequence.clip} on body {sequence.body_index}: {error}", flush=True)
            progress()
            continue
        middle = slice(len(cloth) // 2, len(cloth) // 2 + 1)
        errors.append(transfer_error(worn, cloth[middle], found[middle], pose[middle], root[middle]))
        shape = np.zeros((len(pose), SHAPE))
        shape[:, : len(sequence.shape)] = sequence.shape
        for name, array in (("displacements", found), ("pose", pose), ("root", root), ("shape", shape)):
            rows[name].append(array)
        numbers.append(np.full(len(pose), sequence.body_index))
        kept.append(sequence)
        progress()
    progress.finish()
    if not kept:
        raise ValueError(f"{spec['garment']}: no sequence could be brought to the body's topology")
    arrays = {name: np.concatenate(parts) for name, parts in rows.items()}
    write_layer(
        job.outputs[0],
        LayerFile(
            type=spec["garment"],
            body_name=own.name,
            body_digest=own.digest,
            covered=layer.covered,
            body_index=np.concatenate(numbers),
            sequence=np.repeat(np.arange(len(kept)), [len(n) for n in numbers]),
            splits=tuple(s.split for s in kept),
            clips=tuple(s.clip for s in kept),
            **arrays,
        ),
    )
    together = TransferError(*(np.concatenate([getattr(e, n) for e in errors]) for n in ("distance", "gap")))
    row = {"type": spec["garment"], "sequences": len(kept), "frames": len(arrays["pose"])}
    row |= {"left_out": len(sequences) - len(kept), "covered_vertices": len(layer.covered)}
    length = np.linalg.norm(arrays["displacements"], axis=2)
    row |= {"displacement_mm": 1e3 * float(length.mean()), "largest_mm": 1e3 * float(length.max())}
    write_table(job.outputs[1], [row | together.figures()])


if __name__ == "__main__":
    run_stage(main)

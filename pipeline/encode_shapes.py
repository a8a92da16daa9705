"""Stage ``encode_shapes``: every simulated frame of a garment as its descriptor, once for all that build on it.

In: the shape descriptor in use and all shards of a garment. Out: a file of codes (``datasets.codes``), from which the
variants of the motion-invariant autoencoder are trained and evaluated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

from body.model import Body
from datasets.codes import CodedSequence, file_digest, write_codes
from datasets.sequences import load_sequences, to_canonical
from datasets.splits import SplitRule
from models.shape_descriptor import ShapeDescriptor, encode_all, load_shape_descriptor
from models.training import resolve_device
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Encode shard by shard: the vertices of all shards would fill the memory."""
    descriptor_path, *shards = job.inputs
    descriptor = load_shape_descriptor(descriptor_path).to(resolve_device(job.device))
    rule, body = SplitRule(**job.spec["splits"]), job_body(job)
    sequences = (s for path in shards for s in coded_sequences(path, rule, descriptor, body))
    write_codes(job.outputs[0], file_digest(descriptor_path), sequences)


def coded_sequences(shard: str, rule: SplitRule, descriptor: ShapeDescriptor, body: Body) -> Iterator[CodedSequence]:
    """The sequences of a shard, their vertices replaced by descriptors."""
    for sequence in load_sequences([shard], rule):
        own = {f.name: getattr(sequence, f.name) for f in fields(CodedSequence) if f.name != "codes"}
        vertices = to_canonical(sequence.vertices, sequence.pose, sequence.root, body)
        yield CodedSequence(codes=encode_all(descriptor, vertices), **own)


if __name__ == "__main__":
    run_stage(main)

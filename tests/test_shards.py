"""Shards: what is written is read back; what is damaged or does not fit is refused; a killed write leaves nothing."""

from __future__ import annotations

from dataclasses import replace

import h5py
import numpy as np
import pytest

from datasets.sequences import load_sequences
from datasets.shards import (
    BODIES,
    DroppedSimulation,
    ShardHeader,
    ShardWriter,
    SimulatedSequence,
    read_dropped,
    read_header,
    read_quality,
    read_sequences,
)
from datasets.splits import SplitRule

NAMES = ("density", "bend")


@pytest.fixture
def header() -> ShardHeader:
    return ShardHeader(
        garment="skirt",
        plan="materials",
        solver_version="1",
        seed=7,
        fps=30.0,
        spec="{}",
        template_vertices=np.random.default_rng(0).normal(size=(40, 3)).astype(np.float32),
        template_faces=np.arange(30, dtype=np.int32).reshape(10, 3),
        pinned=np.array([1, 2], dtype=np.int32),
        body_name="small",
        body_digest="abc",
        body_faces=np.arange(12, dtype=np.int32).reshape(4, 3),
        body_shape=np.zeros(10),
        parameter_names=NAMES,
        parameter_units=("kg/m^2", "N m"),
        parameter_groups=("material", "material"),
    )


def make_sequence(seed: int = 0, frames: int = 60, vertices: int = 40) -> SimulatedSequence:
    rng = np.random.default_rng(seed)

    def draw(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32)

    return SimulatedSequence(
        clip="walk_000",
        take="walk_000",
        take_index=3,
        label="walk",
        phi=5,
        parameters={"density": 0.2, "bend": 1e-5},
        vertices=draw(frames, vertices, 3),
        pose=draw(frames, 24, 3),
        root=draw(frames, 3),
        joints=draw(frames, 24, 3),
        lead_pose=draw(8, 24, 3),
        lead_root=draw(8, 3),
        lead_joints=draw(8, 24, 3),
        quality={"max_edge_strain": 0.1, "attempts": 1},
    )


def test_what_is_written_is_read_back(tmp_path, header):
    path, first, second = tmp_path / "a.h5", make_sequence(0), make_sequence(1)
    lost = DroppedSimulation("run_001", "run", 9, "diverged at frame 3", 3)
    with ShardWriter(path, header) as writer:
        writer.add(first)
        writer.drop(lost)
        writer.add(second)
    back = list(read_sequences(path))
    assert len(back) == 2
    for wrote, read in zip((first, second), back):
        for name in ("vertices", "pose", "root", "joints", "lead_pose", "lead_root", "lead_joints"):
            np.testing.assert_array_equal(getattr(wrote, name), getattr(read, name))
        assert (read.clip, read.take_index, read.phi, read.parameters) == ("walk_000", 3, 5, wrote.parameters)
        assert read.quality == wrote.quality
    assert read_dropped(path) == [lost]
    assert read_quality(path)[0]["parameter_bend"] == 1e-5
    found = read_header(path)
    np.testing.assert_array_equal(found.template_faces, header.template_faces)
    assert (found.parameter_units, found.plan, found.fps) == (header.parameter_units, "materials", 30.0)


def test_a_sequence_knows_its_body_and_readers_of_one_body_get_one(tmp_path, header):
    header = replace(header, body_shape=np.array([0.5, -0.5]))
    shaped = replace(make_sequence(0), phi=0, shape=np.array([1.0, -2.0, 0.25]), body_index=4)
    paths = {plan: tmp_path / f"{plan}.h5" for plan in ("motions", "bodies")}
    for plan, sequence in (("motions", make_sequence(1)), ("bodies", shaped)):
        with ShardWriter(paths[plan], replace(header, plan=plan)) as writer:
            writer.add(sequence)
    rule = SplitRule(5, 5, bodies_every=4)
    own = load_sequences(paths.values(), rule)
    assert [s.plan for s in own] == ["motions"] and own[0].body_index == 0
    np.testing.assert_array_equal(own[0].shape, [0.5, -0.5])
    (other,) = load_sequences(paths.values(), rule, plans=(BODIES,))
    assert (other.body_index, other.split) == (4, "unseen_bodies")
    np.testing.assert_array_equal(other.shape, [1.0, -2.0, 0.25])
    assert read_quality(paths["bodies"])[0]["body_index"] == 4
    with h5py.File(paths["motions"], "a") as file:  # as shards were before there were body shapes
        for name in ("shape", "body_index"):
            del file["sequences/0000"].attrs[name]
    (old,) = load_sequences([paths["motions"]], rule)
    assert old.body_index == 0 and list(old.shape) == [0.5, -0.5]


def test_arrays_of_sequences_that_nobody_wants_are_not_read(tmp_path, header):
    path, rule = tmp_path / "a.h5", SplitRule(parameters_every=4, takes_every=2)
    with ShardWriter(path, header) as writer:
        for phi in (3, 4):
            writer.add(replace(make_sequence(phi), phi=phi, take_index=0))
    with h5py.File(path, "a") as file:
        del file["sequences/0000/vertices"]
    assert [s.phi for s in read_sequences(path, lambda phi, *_: phi == 4)] == [4]
    splits = [rule.split(phi, 0, "walk", 0) for phi in (3, 4)]
    assert splits[0] != splits[1]
    assert [s.phi for s in load_sequences([path], rule, (splits[1],))] == [4]
    with pytest.raises(ValueError, match=r"a\.h5"):
        load_sequences([path], rule, (splits[0],))


def test_failure_leaves_no_file(tmp_path, header):
    with pytest.raises(RuntimeError), ShardWriter(tmp_path / "a.h5", header) as writer:
        writer.add(make_sequence())
        raise RuntimeError("killed")
    assert list(tmp_path.iterdir()) == []


def test_sequences_that_do_not_fit_are_refused(tmp_path, header):
    with ShardWriter(tmp_path / "a.h5", header) as writer:
        with pytest.raises(ValueError, match=r"vertices has shape \[60, 41, 3\], expected \[60, 40, 3\]"):
            writer.add(make_sequence(vertices=41))
        bad = make_sequence()
        bad.vertices[3, 2, 1] = np.nan
        with pytest.raises(ValueError, match="vertices holds a number that is not finite"):
            writer.add(bad)
        for shape in (np.zeros(11), np.array([np.inf]), np.zeros((2, 2))):
            with pytest.raises(ValueError, match="expected at most 10 finite body shape coefficients"):
                writer.add(replace(make_sequence(), shape=shape))


def test_files_that_are_no_shards_are_refused(tmp_path, header):
    text = tmp_path / "text.h5"
    text.write_text("no")
    with pytest.raises(ValueError, match="not a readable HDF5 file"):
        read_header(text)
    with ShardWriter(tmp_path / "a.h5", header) as writer:
        writer.add(make_sequence())
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file.attrs["version"] = 99
    with pytest.raises(ValueError, match="version 99; this program reads 'drapeline-shard', version 1"):
        read_header(tmp_path / "a.h5")


def without_values(file: h5py.File) -> None:
    del file["sequences/0000/parameters"]
    file["sequences/0000/parameters"] = np.zeros(0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f["sequences/0000/vertices"].__setitem__((1, 2, 0), np.nan), "sequence walk_000: vertices holds"),
        (lambda f: f.__delitem__("sequences/0000/root"), "'root' doesn't exist"),
        (lambda f: f.__delitem__("garment/vertices"), "'vertices' doesn't exist"),
        (lambda f: f["sequences/0000"].attrs.__delitem__("clip"), "'clip'"),
        (lambda f: f.__delitem__("parameters"), "the shard lacks a part"),
        (without_values, r"sequence walk_000: parameters \[\] do not fit the shard"),
    ],
)
def test_a_damaged_shard_is_named(tmp_path, header, change, message):
    path = tmp_path / "shard.h5"
    with ShardWriter(path, header) as shard:
        shard.add(make_sequence(frames=4))
    assert len(list(read_sequences(path))) == 1
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(ValueError, match=message) as caught:
        read_header(path)
        list(read_sequences(path))
    assert str(path) in str(caught.value)

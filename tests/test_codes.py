"""Files of codes: what is written comes back, foreign and damaged ones are refused, the stage encodes what it says."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
import torch

from body.model import Body
from datasets.codes import CodedSequence, file_digest, read_codes, write_codes
from datasets.sequences import Sequence, to_canonical
from datasets.splits import SplitRule
from models.shape_descriptor import PaperDescriptor, ShapeDescriptorConfig, encode_all
from pipeline import encode_shapes
from pipeline.intrinsic_data import all_codes, check_same_frames

MADE_BY = "a" * 64


def coded(clip: str, phi: int, split: str, frames: int, lead: int = 2, garment: str = "skirt") -> CodedSequence:
    rng = np.random.default_rng(phi)

    def some(*shape):
        return rng.normal(size=shape).astype(np.float32)

    return CodedSequence(
        garment, clip, clip, "walk", "materials", phi, split, 30.0, some(frames, 5),
        some(frames, 24, 3), some(frames, 3), some(frames, 24, 3),
        some(lead, 24, 3), some(lead, 3), some(lead, 24, 3), {"density": 0.1 * phi, "drag": 1.0},
    )  # fmt: skip


@pytest.fixture
def path(tmp_path):
    found = tmp_path / "codes.h5"
    write_codes(found, MADE_BY, [coded("a", 1, "train", 4), coded("b", 2, "unseen_both", 3, lead=0)])
    return found


def test_what_is_written_comes_back(path):
    first, second = read_codes(path, "skirt", MADE_BY)
    for got, wanted in ((first, coded("a", 1, "train", 4)), (second, coded("b", 2, "unseen_both", 3, lead=0))):
        for name, value in vars(wanted).items():
            assert (
                np.array_equal(getattr(got, name), value)
                if isinstance(value, np.ndarray)
                else (getattr(got, name) == value)
            ), name
    assert all_codes([first, second]).shape == (7, 5)


def test_only_the_asked_splits_and_plans_are_read(path):
    assert [s.clip for s in read_codes(path, "skirt", MADE_BY, ("unseen_both",))] == ["b"]
    with pytest.raises(ValueError, match="no simulated sequence in splits any of plans motions"):
        read_codes(path, "skirt", MADE_BY, plans=("motions",))


def test_codes_of_another_garment_or_descriptor_are_refused(path):
    with pytest.raises(ValueError, match="codes of garment 'skirt', not of 'tshirt'"):
        read_codes(path, "tshirt", MADE_BY)
    with pytest.raises(ValueError, match=r"encoded by descriptor aaaaaaaaaaaa.*encode the shapes again"):
        read_codes(path, "skirt", "b" * 64)


def damage(file: h5py.File, how: str) -> None:
    if how == "version":
        file.attrs["version"] = 2
    elif how == "lacks":
        del file["joints"]
    elif how == "shape":
        values = file["codes"][:-1]
        del file["codes"]
        file["codes"] = values
    elif how == "finite":
        file["codes"][2, 1] = np.nan
    elif how == "split":
        file["split"][0] = "yesterday"
    else:
        file["frames"][0] = -1


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("version", "this program reads 'drapeline-codes', version 1"),
        ("lacks", "lacks a part"),
        ("shape", r"codes has shape \[6, 5\], which does not fit its 7 frames"),
        ("finite", "codes holds a number that is not finite"),
        ("split", "split 'yesterday' is not one of train"),
        ("frames", "numbers of frames or parameters are impossible"),
    ],
)
def test_a_damaged_file_is_refused_in_one_sentence(path, how, said):
    with h5py.File(path, "r+") as file:
        damage(file, how)
    with pytest.raises(ValueError, match=said) as error:
        read_codes(path, "skirt", MADE_BY)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_a_file_that_is_no_hdf5_is_refused(tmp_path):
    (tmp_path / "codes.h5").write_text("nothing")
    with pytest.raises(ValueError, match="not a readable HDF5 file"):
        read_codes(tmp_path / "codes.h5", "skirt", MADE_BY)


def test_sequences_that_do_not_belong_together_leave_no_file(tmp_path):
    mixed = [coded("a", 1, "train", 4), coded("b", 2, "train", 3, garment="tshirt")]
    with pytest.raises(ValueError, match="sequence b of tshirt at 30 Hz does not belong with a of skirt"):
        write_codes(tmp_path / "codes.h5", MADE_BY, mixed)
    with pytest.raises(ValueError, match="no sequence"):
        write_codes(tmp_path / "codes.h5", MADE_BY, [])
    assert list(tmp_path.iterdir()) == []


def test_codes_of_other_frames_than_the_shards_are_noticed():
    codes = [coded("a", 1, "train", 4), coded("b", 2, "train", 3)]
    check_same_frames(codes, codes)
    with pytest.raises(ValueError, match="set 1 on a stand where the shards have set 2 on b"):
        check_same_frames(codes, codes[::-1])
    with pytest.raises(ValueError, match="2 sequences are encoded, but the shards hold 1"):
        check_same_frames(codes, codes[:1])


def test_the_stage_encodes_canonical_frames(monkeypatch, tmp_path):
    body = Body.load("small")
    one = coded("a", 1, "train", 4)
    faces = np.array([[0, 1, 2]])
    vertices = np.random.default_rng(0).normal(size=(4, 3, 3)).astype(np.float32)
    own = {name: value for name, value in vars(one).items() if name != "codes"}
    sequence = Sequence(vertices=vertices, **own)
    monkeypatch.setattr(encode_shapes, "load_sequences", lambda paths, rule: [sequence])
    torch.manual_seed(0)
    module = PaperDescriptor(ShapeDescriptorConfig(code=5, hidden=(8,)), faces, 3).eval()
    (found,) = encode_shapes.coded_sequences("shard.h5", SplitRule(5, 5), module, body)
    expected = encode_all(module, to_canonical(vertices, one.pose, one.root, body))
    assert np.allclose(found.codes, expected) and found.parameters == one.parameters
    (tmp_path / "model.pt").write_bytes(b"weights")
    write_codes(tmp_path / "codes.h5", file_digest(tmp_path / "model.pt"), [found])
    (tmp_path / "model.pt").write_bytes(b"other weights")
    with pytest.raises(ValueError, match="encode the shapes again"):
        read_codes(tmp_path / "codes.h5", "skirt", file_digest(tmp_path / "model.pt"))

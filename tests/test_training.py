"""The training loop: resumed runs equal uninterrupted ones, bad runs stop with a sentence."""

from __future__ import annotations

import csv

import numpy as np
import pytest
import torch
from torch import nn

from models.checkpoint import load_model, save_model
from models.training import TrainingSettings, array_digest, epoch_generator, shuffled_batches, train


class Killed(Exception):
    """Stands for a kill in the middle of an epoch."""


def problem(seed: int = 0):
    """A net with dropout and batch norm, so that random state and buffers matter, and noisy data for it."""
    generator = torch.Generator().manual_seed(1)
    x = torch.randn(40, 3, generator=generator)
    y = (x.sum(1, keepdim=True)).sin()
    torch.manual_seed(seed)
    net = nn.Sequential(nn.Linear(3, 16), nn.BatchNorm1d(16), nn.ReLU(), nn.Dropout(0.3), nn.Linear(16, 1))
    return net, x, y


def run(folder, settings, kill_at: int | None = None, said: list[str] | None = None, identity: str = "", scale=1.0):
    net, x, y = problem()

    def epoch_batches(epoch, generator):
        for number, index in enumerate(shuffled_batches(len(x), 8, generator)):
            if kill_at is not None and epoch == kill_at and number == 2:
                raise Killed
            yield torch.from_numpy(index)

    def loss(index):
        error = (net(x[index]) - y[index]).square().mean() * scale
        return {"total": error, "twice": 2 * error}

    def validate():
        return {"total": float((net(x) - y).square().mean())}

    log = train(
        net, epoch_batches, loss, settings, folder, validate, (said if said is not None else []).append, identity
    )
    return net, log


def rows_of(folder):
    with (folder / "losses.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("changes", [{}, {"optimizer": "sgd", "schedule": "plateau", "plateau_patience": 0}])
def test_killed_run_continues_to_the_same_weights(tmp_path, changes):
    settings = TrainingSettings(
        **{"epochs": 7, "checkpoint_every": 2, "schedule": "cosine", "warmup_steps": 12, "gradient_clip": 1.0}
        | changes,
        learning_rate=0.05,
        device="cpu",
    )
    whole, log = run(tmp_path / "whole", settings)
    with pytest.raises(Killed):
        run(tmp_path / "killed", settings, kill_at=5)
    said: list[str] = []
    continued, continued_log = run(tmp_path / "killed", settings, said=said)
    assert continued_log.resumed_at == 4
    assert said[0] == "continuing after epoch 4 of 7"
    for name, value in whole.state_dict().items():
        assert torch.equal(value, continued.state_dict()[name]), name
    first, second = rows_of(tmp_path / "whole"), rows_of(tmp_path / "killed")
    assert [(r["epoch"], r["split"]) for r in first] == [
        (str(e), s) for e in range(1, 8) for s in ("train", "validation")
    ]
    for a, b in zip(first, second, strict=True):
        assert {k: v for k, v in a.items() if k != "seconds"} == {k: v for k, v in b.items() if k != "seconds"}
    assert log.last("validation")["total"] == continued_log.last("validation")["total"]


def test_what_is_set_before_the_first_epoch_is_set_once_and_is_in_the_table(tmp_path):
    net, x, y = problem()
    calls: list[int] = []

    def begin():
        calls.append(1)
        with torch.no_grad():
            net[0].weight.fill_(0.25)
        return {"set": 0.25}

    def once(epochs: int, rate: float = 1e-9):
        settings = TrainingSettings(epochs=epochs, learning_rate=rate, device="cpu")
        batches = [torch.arange(len(x))]
        return train(
            net,
            lambda epoch, generator: batches,
            lambda index: {"total": (net(x[index]) - y[index]).square().mean()},
            settings,
            tmp_path,
            begin=begin,
        )

    log = once(1)
    assert [(r["epoch"], r["split"], r.get("set")) for r in log.rows] == [(0, "begin", 0.25), (1, "train", None)]
    assert torch.allclose(net[0].weight, torch.tensor(0.25), atol=1e-6)
    assert rows_of(tmp_path)[0]["set"] == "0.25"
    assert once(1).resumed_at == 1 and len(calls) == 1
    assert once(1, rate=2e-9).resumed_at == 0 and len(calls) == 2


def test_finished_run_is_not_trained_again(tmp_path):
    settings = TrainingSettings(epochs=2, device="cpu")
    first, _ = run(tmp_path, settings)
    second, log = run(tmp_path, settings, kill_at=0)
    assert log.resumed_at == 2
    assert torch.equal(first[0].weight, second[0].weight)


@pytest.mark.parametrize("change", ["settings", "data", "damage"])
def test_foreign_checkpoint_is_not_continued(tmp_path, change):
    settings = TrainingSettings(epochs=2, device="cpu")
    run(tmp_path, settings, identity="a")
    said: list[str] = []
    if change == "damage":
        (tmp_path / "checkpoint.pt").write_bytes(b"not a checkpoint")
    other = TrainingSettings(epochs=2, device="cpu", learning_rate=0.5) if change == "settings" else settings
    _, log = run(tmp_path, other, said=said, identity="b" if change == "data" else "a")
    assert log.resumed_at == 0
    assert said[0].endswith("training starts anew")


def test_seed_decides(tmp_path):
    settings = {"epochs": 2, "device": "cpu"}
    first, _ = run(tmp_path / "a", TrainingSettings(**settings, seed=3))
    same, _ = run(tmp_path / "b", TrainingSettings(**settings, seed=3))
    other, _ = run(tmp_path / "c", TrainingSettings(**settings, seed=4))
    assert torch.equal(first[0].weight, same[0].weight)
    assert not torch.equal(first[0].weight, other[0].weight)


def test_cosine_ends_low_and_warmup_starts_low(tmp_path):
    _, log = run(
        tmp_path, TrainingSettings(epochs=20, schedule="cosine", warmup_steps=10, learning_rate=1.0, device="cpu")
    )
    rates = [row["learning_rate"] for row in log.rows if row["split"] == "train"]
    assert rates[0] == pytest.approx(0.5)
    assert max(rates) < 1.0
    assert rates[-1] < 0.03


def test_divergence_names_epoch_and_batch(tmp_path):
    with pytest.raises(ValueError, match="diverged at epoch 1, batch 1"):
        run(tmp_path, TrainingSettings(epochs=1, device="cpu"), scale=float("nan"))
    assert not (tmp_path / "checkpoint.pt").exists()


def test_reduced_precision_is_put_back(tmp_path):
    before = torch.get_float32_matmul_precision()
    run(tmp_path, TrainingSettings(epochs=1, device="cpu", precision="medium"))
    assert torch.get_float32_matmul_precision() == before


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"optimizer": "adamant"}, "not one of adam, sgd, rmsprop"),
        ({"schedule": "sine"}, "not one of constant, cosine, plateau"),
        ({"epochs": 0}, "epochs: must be at least 1"),
        ({"learning_rate": float("nan")}, "learning_rate: must be above 0"),
    ],
)
def test_bad_settings_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        TrainingSettings(**values)


def test_batches_cover_all_and_leave_no_single_sample():
    parts = list(shuffled_batches(65, 64, epoch_generator(0, 0)))
    assert sorted(np.concatenate(parts)) == list(range(65))
    assert min(map(len, parts)) == 32


def test_digest_sees_content_shape_and_type():
    a = np.arange(6, dtype=np.float32)
    digests = {array_digest(x) for x in (a, a.reshape(2, 3), a.astype(np.float64), a + 1)}
    assert len(digests) == 4


def test_model_file_round_trip_and_refusals(tmp_path):
    net, _, _ = problem()
    path = tmp_path / "net.pt"
    save_model(path, "net", {"width": (16, 1), "name": "x"}, net, {"unit": torch.ones(2)})
    stored = load_model(path, "net")
    assert stored.config == {"width": [16, 1], "name": "x"}
    assert torch.equal(stored.extra["unit"], torch.ones(2))
    other, _, _ = problem(seed=5)
    stored.into(other)
    assert torch.equal(other[0].weight, net[0].weight)
    assert not other.training
    with pytest.raises(ValueError, match="holds a model of kind 'net', expected 'other'"):
        load_model(path, "other")
    with pytest.raises(ValueError, match="does not fit its module"):
        stored.into(nn.Linear(2, 2))
    with pytest.raises(ValueError, match="does not exist"):
        load_model(tmp_path / "none.pt", "net")
    with pytest.raises(ValueError, match="plain values only"):
        save_model(path, "net", {"width": np.float64(1.0)}, net)
    torch.save({"a": 1}, path)
    with pytest.raises(ValueError, match="is not a drapeline-model file"):
        load_model(path, "net")
    path.write_bytes(b"junk")
    with pytest.raises(ValueError, match="not a readable model file"):
        load_model(path, "net")


def test_model_file_runs_no_code(tmp_path):
    class Payload:
        def __reduce__(self):
            return (print, ("ran",))

    torch.save({"format": "drapeline-model", "config": Payload()}, tmp_path / "evil.pt")
    with pytest.raises(ValueError, match="not a readable model file"):
        load_model(tmp_path / "evil.pt", "net")

"""GSNet's linear map in closed form: what it finds on cloth that is linear, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from body.model import Body
from models.garment_graph import GarmentGraph
from models.gsnet_anchor import AnchorSettings, anchor
from models.gsnet_examples import TrainingData
from models.gsnet_fitting import AnimatorTraining, build_animator, fit_animator, load_animator, save_animator
from models.training import TrainingSettings
from tests.test_gsnet import COTTON, FRAMES, LEAD, MATERIALS, example, track, tube

SMALL = {"width": 32, "heads": 2, "hidden": (16, 16), "offsets": (0, 1), "garment_state": False, "linear": True}


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


def network(body: Body, **changes):
    torch.manual_seed(0)
    return build_animator("gsnet", {"materials": MATERIALS, "body": body.digest, **SMALL, **changes})


def wardrobe(body: Body, clips: int):
    """Three tubes whose hems lag behind the pelvis: linear in the motion of two frames."""
    graphs = [GarmentGraph.of(tube(body, around, 5, name=str(around)), body) for around in (7, 9, 12)]
    return [example(body, graph, 100 * i + k) for i, graph in enumerate(graphs) for k in range(clips)]


def error(made, examples, body) -> float:
    return float(
        np.mean([np.abs(made.dress(e.graph, e.material, e.track, body) - e.vertices).mean() for e in examples])
    )


def test_what_is_linear_in_the_motion_is_found_without_a_step_of_training(body):
    examples = wardrobe(body, clips=60)
    data, made = TrainingData(examples, body, 2, False), network(body)
    data.scale(made)
    found = anchor(made.train(), data, AnchorSettings(penalty=1e-2, epochs=250))
    skinning = build_animator("skinning", {"materials": MATERIALS, "body": body.digest})
    unseen = GarmentGraph.of(tube(body, 10, 5), body)
    for graph in (examples[0].graph, unseen):  # on new clips, and on a template that nobody knew
        fresh = [example(body, graph, 900 + i) for i in range(12)]
        assert error(made, fresh, body) < 0.35 * error(skinning, fresh, body)
    assert found["edges_rms_mm"] < 0.2 * found["linear_rms_mm"]


def test_the_linear_map_is_the_ridge_regression_of_each_garment(body):
    """With edges enough for all of them, the messages span what the regressions say: checked by plain NumPy."""
    examples = [e for e in wardrobe(body, clips=16) if e.graph.name != "9"]
    data, made = TrainingData(examples, body, 2, False), network(body)
    data.scale(made)
    anchor(made, data, AnchorSettings(penalty=0.1, epochs=1))
    skinning = build_animator("skinning", {"materials": MATERIALS, "body": body.digest})
    now = LEAD + torch.arange(FRAMES)
    for graph in data.graphs:
        rows = [i for i, e in enumerate(examples) if e.graph is graph]
        x = np.concatenate([made.past(data.motion.take(torch.tensor([data.clip[i]])), now)[0].numpy() for i in rows])
        left = [examples[i].vertices - skinning.dress(graph, COTTON, examples[i].track, body) for i in rows]
        y = np.concatenate(left).reshape(len(x), -1)
        x1 = np.concatenate([x, np.ones((len(x), 1))], axis=1).astype(np.float64)
        penalty = len(x) * 0.1 * np.diag([*np.ones(x.shape[1]), 1e-3])
        said = x1 @ np.linalg.solve(x1.T @ x1 + penalty, x1.T @ y)
        sent = made.linear(torch.as_tensor(x)).unflatten(1, (-1, 3)).numpy(force=True)  # [frames, K, 3]
        columns = sent.transpose(0, 2, 1).reshape(-1, sent.shape[1])
        wanted = said.reshape(len(x), -1, 3).transpose(0, 2, 1).reshape(len(columns), -1)
        best = columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0]
        assert np.abs(best - wanted).max() < 0.02 * np.abs(wanted).max()


def test_training_goes_on_from_there_and_the_linear_map_stays(body, tmp_path):
    examples = wardrobe(body, clips=6)
    made = network(body)
    settings = AnimatorTraining(
        training=TrainingSettings(epochs=2, learning_rate=1e-3, device="cpu"),
        anchor=AnchorSettings(epochs=20),
        loss="distance",
        physics_frames=0,
    )
    log = fit_animator(made, examples, body, settings, tmp_path, examples[:2])
    assert [(r["epoch"], r["split"]) for r in log.rows[:2]] == [(0, "begin"), (1, "train")]
    assert log.rows[0]["edges_rms_mm"] > 0.0 and log.rows[0]["seconds"] > 0.0
    again = network(body)
    data = TrainingData(examples, body, settings.contact_frames, False)
    torch.manual_seed(0)
    data.scale(again)
    anchor(again, data, settings.anchor)
    assert torch.equal(made.linear.weight, again.linear.weight)
    assert not torch.equal(made.joints[-1].weight, again.joints[-1].weight)
    save_animator(tmp_path / "model.pt", made)
    loaded = load_animator(tmp_path / "model.pt")
    motion = track(body, 77)
    dressed = made.dress(examples[0].graph, COTTON, motion, body)
    assert np.array_equal(loaded.dress(examples[0].graph, COTTON, motion, body), dressed)


@pytest.mark.parametrize("linear", [True, False])
def test_training_stays_on_the_cpu_where_there_is_a_gpu(body, tmp_path, monkeypatch, linear):
    def device_of(name: str) -> torch.device:
        assert name == "cpu", "a GPU would be taken"
        return torch.device("cpu")

    monkeypatch.setattr("models.training.resolve_device", device_of)
    made = network(body, linear=linear)
    settings = AnimatorTraining(
        training=TrainingSettings(epochs=1, device="auto"), anchor=AnchorSettings(epochs=2), physics_frames=0
    )
    fit_animator(made, wardrobe(body, clips=2), body, settings, tmp_path)
    assert {p.device.type for p in made.parameters()} == {"cpu"}


def test_what_cannot_be_anchored_is_refused(body, tmp_path):
    examples = wardrobe(body, clips=2)
    data = TrainingData(examples, body, 2, False)
    with pytest.raises(ValueError, match="only a network with a linear map"):
        anchor(network(body, linear=False), data, AnchorSettings())
    settings = AnimatorTraining(mirror=True)
    with pytest.raises(ValueError, match="linear map is that of the garments as they are, so mirror must be false"):
        fit_animator(network(body), examples, body, settings, tmp_path)
    for name in ("penalty", "learning_rate", "gradient_clip"):
        with pytest.raises(ValueError, match=f"gsnet anchor {name}: must be above 0, got 0"):
            replace(AnchorSettings(), **{name: 0})
    with pytest.raises(ValueError, match="gsnet anchor epochs: must be at least 1, got 0"):
        AnchorSettings(epochs=0)

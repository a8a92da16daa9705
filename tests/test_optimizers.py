"""Optimizers without torch's compiler: the same steps, the same state, and the compiler is not loaded."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

# Torch's own optimizers load the compiler, and with it Triton where torch is built for GPUs. Triton must be loaded
# before the renderer's software OpenGL: both hold an LLVM, and in the other order the process crashes.
import torch._dynamo

from models import optimizers

OPTIONS = {
    "AdamW": {"lr": 0.01, "weight_decay": 0.1, "fused": True},
    "RMSprop": {"lr": 0.01, "momentum": 0.5},
    "SGD": {"lr": 0.1, "momentum": 0.9, "weight_decay": 0.01},
}


def steps(kind: type[torch.optim.Optimizer], options: dict, count: int, state: dict | None = None):
    """Weights and state after some steps from the same weights, or from those of a saved state."""
    torch.manual_seed(3)
    layer, data = torch.nn.Linear(4, 3), torch.randn(count, 8, 4)
    optimizer = kind(layer.parameters(), **options)
    if state is not None:
        optimizer.load_state_dict(state)
    for batch in data:
        optimizer.zero_grad(set_to_none=True)
        layer(batch).square().mean().backward()
        optimizer.step()
    return torch.cat([p.detach().flatten() for p in layer.parameters()]), optimizer.state_dict()


@pytest.mark.parametrize("name", OPTIONS)
def test_steps_and_state_are_those_of_torch(name):
    ours, theirs = getattr(optimizers, name), getattr(torch.optim, name)
    found, state = steps(ours, OPTIONS[name], 5)
    expected, expected_state = steps(theirs, OPTIONS[name], 5)
    assert torch.equal(found, expected)
    # What one has saved, the other continues from.
    onwards, _ = steps(ours, OPTIONS[name], 2, expected_state)
    assert torch.equal(onwards, steps(theirs, OPTIONS[name], 2, state)[0])


def test_a_training_does_not_load_the_compiler(tmp_path):
    code = f"""
import sys, torch
from models.training import TrainingSettings, train
layer = torch.nn.Linear(4, 3)
settings = TrainingSettings(epochs=2, device="cpu", learning_rate=0.01, gradient_clip=1.0)
loss = lambda x: {{"total": layer(x).square().mean()}}
train(layer, lambda *_: [torch.ones(2, 4)], loss, settings, {str(tmp_path)!r})
sys.exit(any(name.startswith(("torch._dynamo", "sympy")) for name in sys.modules))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr

"""Torch's optimizers without its compiler, which each of them would load and none of them uses.

Torch wraps the methods of an optimizer so that ``torch.compile`` leaves them alone, and the wrappers load that compiler
at their first call: a second of a core, longer than a tiny model trains. Nothing here is compiled, so that the methods
can stand without their wrappers; what they compute and what they save is the same.
"""

from __future__ import annotations

import inspect

import torch
from torch.optim import Optimizer

_WRAPPED = ("add_param_group", "load_state_dict", "state_dict", "zero_grad")


def without_compiler(kind: type[Optimizer]) -> type[Optimizer]:
    """A subclass of an optimizer's class that steps as it does and never loads ``torch.compile``'s parts."""
    bare = {name: inspect.unwrap(getattr(kind, name)) for name in _WRAPPED}
    # The wrapper of a step is also what keeps gradients off while the weights change.
    return type(kind.__name__, (kind,), {**bare, "step": torch.no_grad()(inspect.unwrap(kind.step))})


AdamW = without_compiler(torch.optim.AdamW)
RMSprop = without_compiler(torch.optim.RMSprop)
SGD = without_compiler(torch.optim.SGD)

"""What a schema cannot say of motions and of the data plans: counts that must fit each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.config.layers import Layer, fault
from pipeline.config.materials import check_fabric, check_parameter


def check_motions(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """The motions can be planned, are enough for every plan, and have takes to hold out."""
    from pipeline.plan import plan_clips

    motions = config["motions"]
    key = ("motions", motions["source"])
    try:
        clips = plan_clips(motions)
    except (ValueError, OSError) as error:
        raise fault(layers, key, str(error), "correct the source of the motions") from None
    rule = config["data"]["splits"]["takes_every"]
    for plan in ("materials", "bodies"):
        wanted = config["data"][plan]["clips"]
        if wanted > len(clips):
            allowed = f"the motions give {len(clips)} clips at most"
            raise fault(layers, ("data", plan, "clips"), f"found {wanted}", allowed)
    takes = 1 + max(c.take_index for c in clips)
    if takes < rule:
        raise fault(
            layers,
            ("data", "splits", "takes_every"),
            f"found {rule} with {takes} takes",
            f"at most {takes}, or no motion is held out",
        )


def check_data(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """Enough of each plan to hold one out, in whole shards."""
    for plan, rule, what in (("materials", "parameters_every", "set"), ("bodies", "bodies_every", "body")):
        settings, every = config["data"][plan], config["data"]["splits"][rule]
        samples, size = settings["samples"], settings["samples_per_shard"]
        key, found = ("data", plan, "samples"), f"found {samples}"
        if 0 < samples < every:
            none = ", or 0 for no such data" if plan == "bodies" else ""
            raise fault(layers, key, found, f"at least {rule} = {every}, or no {what} is held out{none}")
        if samples % size:
            # A shard that is not full would change when samples are added, and be simulated again.
            raise fault(layers, key, found, f"allowed are multiples of samples_per_shard = {size}")


def check_clothing_layers(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """The outfits that are layers on the body mesh, and what the networks on its levels ask for."""
    settings, place = config["data"]["layers"], ("data", "layers")
    check_fabric((*place, "fabric"), settings["fabric"], layers)
    for name, value in settings["base"].items():
        check_parameter((*place, "base", name), name, value, layers)
    if settings["bodies"] < settings["bodies_every"]:
        allowed = f"at least bodies_every = {settings['bodies_every']}, or no body is held out"
        raise fault(layers, (*place, "bodies"), f"found {settings['bodies']}", allowed)

"""What determines the output of each rule, as one canonical JSON string.

Snakemake reruns a job when its parameters change; it compares them by ``repr`` and forgets their names. So every rule
has exactly one parameter, made here: sorted keys, numbers that are written the same way always come out the same
(``30`` and ``30.0`` alike), and nothing in it that the outputs do not depend on.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from datasets.splits import SplitRule
from evaluation.seeds import seed_names, split_seed
from pipeline.canonical import canonical
from pipeline.plan import (
    PlannedClip,
    batch_clips,
    layer_clips,
    learning_clips,
    motion_labels,
    plan_clips,
    shard_plan,
    shard_simulations,
    tested_clips,
)
from sim.fabrics import base_values

Config = Mapping[str, Any]
MATERIAL_KEYS = ("fabric", "base", "ranges")
"""Keys of a garment that say what it is made of; all others say what shape it has."""


def run_spec(config: Config) -> str:
    """The whole configuration, but for where the work is done."""
    return canonical({key: value for key, value in config.items() if key != "compute"})


def garment_spec(config: Config, garment: str) -> str:
    """A template depends on the body and on the garment's geometry, not on its material."""
    return canonical({"garment": garment, "geometry": garment_geometry(config, garment), "body": config["body"]})


def garment_geometry(config: Config, garment: str) -> dict[str, Any]:
    """The shape of a garment; those of an outfit in the list ``worn``, each with its ``name``."""
    geometry = _without_material(config["garments"][garment])
    if geometry["kind"] == "outfit":
        geometry["worn"] = [_worn_geometry(config, one) for one in geometry["worn"]]
    return geometry


def _worn_geometry(config: Config, one: str | Mapping[str, Any]) -> dict[str, Any]:
    if isinstance(one, str):
        return _without_material(config["garments"][one]) | {"name": one}
    return {"name": worn_name(one), **one}


def worn_name(one: str | Mapping[str, Any]) -> str:
    """Name of a garment in the list ``worn`` of an outfit: one described there is called by its kind."""
    return one if isinstance(one, str) else one.get("name", one.get("worn_as", one["kind"]))


def _without_material(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in settings.items() if key not in MATERIAL_KEYS}


def garment_files(config: Config, garment: str) -> list[str]:
    """The user's files that a template is made from: their content counts, not only their names."""
    geometry = garment_geometry(config, garment)
    return [one["file"] for one in geometry.get("worn", [geometry]) if one["kind"] == "mesh"]


def motions_spec(config: Config, batch: int) -> str:
    """A batch of clips."""
    motions = config["motions"]
    clips = [vars(clip) for clip in batch_clips(motions, batch)]
    spec = {k: motions[k] for k in ("source", "fps", "frames")} | {"clips": clips, "body": config["body"]}
    if motions["source"] == "procedural":
        spec["seed"] = config["seed"]
    else:
        spec |= {"folder": motions["bvh"]["folder"], "labels_file": motions["bvh"]["labels"]}
    return canonical(spec)


def simulate_spec(config: Config, garment: str, shard: str) -> str:
    """A shard depends on one garment's material, the clips and bodies it uses and the solver's settings."""
    settings = config["garments"][garment]
    plan, _ = shard_plan(shard)
    simulations = [[phi, clip.name, clip.take_index] for phi, clip in shard_simulations(config, shard)]
    spec = {
        "garment": garment,
        "plan": plan,
        "seed": config["seed"],
        "body": config["body"],
        "base": base_values(settings),
        "simulations": simulations,
        "fps": config["motions"]["fps"],
        "lead_in": config["motions"]["lead_in"],
        "solver": config["simulation"],
    }
    if plan == "materials":
        spec["ranges"] = {name: [r["min"], r["max"]] for name, r in settings.get("ranges", {}).items()}
    if plan == "bodies":
        spec["spread"] = config["data"]["bodies"]["spread"]
    return canonical(spec)


def tests_spec(config: Config, garment: str) -> str:
    """Simulations that are tested on alone: held-out clips once more, and long motions; base parameters."""
    tests = config["data"]["tests"]
    spec = {
        "garment": garment,
        "seed": config["seed"],
        "body": config["body"],
        "base": base_values(config["garments"][garment]),
        "simulations": [[0, clip.name, clip.take_index] for clip in tested_clips(config)],
        "fps": config["motions"]["fps"],
        "lead_in": config["motions"]["lead_in"],
        "solver": config["simulation"],
        "tests": tests,
        "long_labels": _long_labels(config),
    }
    return canonical(spec)


def _long_labels(config: Config) -> list[str]:
    """Labels of the long motions: generated, whatever the source of the clips, of labels that may be trained on."""
    from motions.procedural import DEFAULT_LABELS

    rule = SplitRule(**config["data"]["splits"])
    known = set(motion_labels(config["motions"]))
    labels = [label for label in DEFAULT_LABELS if not rule.holds_out_label(label)]
    return [label for label in labels if label in known] or labels


def ranges_spec(config: Config, garment: str) -> str:
    """A search of ranges: the material around which it goes, and how it goes."""
    return canonical(
        {
            "garment": garment,
            "seed": config["seed"],
            "body": config["body"],
            "base": base_values(config["garments"][garment]),
            "fps": config["motions"]["fps"],
            "lead_in": config["motions"]["lead_in"],
            "settle": config["simulation"]["settle"],
            "self_contact": config["simulation"]["self_contact"],
            "ranges": config["ranges"],
        }
    )


def train_spec(config: Config, model: str, garment: str = "", variant: str = "") -> str:
    """A trained variant of a garment's model, or a model of the motions where no garment is named.

    A variant may be a repetition from another seed, as ``trained_variants`` names it.
    """
    settings = dict(config["models"][model])
    variant, number = split_seed(variant)
    spec = _learning(config) | {"model": variant_settings(settings["variants"], variant) if variant else settings}
    spec["seed"] += number - 1
    if variant:
        spec["variant"] = variant
    if garment:
        spec["garment"] = garment
    else:
        spec |= _labels(config, learning_clips(config["motions"]))
    if model == "motion_invariant":
        spec["window"] = spec["model"].get("window", settings["window"])
    return canonical(spec)


def variant_settings(variants: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Settings of a variant; one that is ``like`` another holds only what differs from it."""
    own = dict(variants[name])
    model = own.pop("like", None)
    if model is None:
        return own
    below = {"kind": model} | variants[model]
    return below | own | {"training": below["training"] | own.get("training", {})}


def trained_variants(config: Config, model: str) -> list[str]:
    """Names of all trainings of a model's variants, those from further seeds included, in the order of the config."""
    settings = config["models"][model]
    return seed_names(settings["variants"], settings.get("seeds", {}))


def encode_spec(config: Config, garment: str) -> str:
    """A garment's frames as descriptors."""
    return canonical(_learning(config) | {"garment": garment})


def curve_spec(config: Config, garment: str) -> str:
    """The shape descriptor in use, at the lengths of the curve in its size, and without the Laplacian term."""
    settings = config["models"]["shape_descriptor"]
    model, curve = settings["variants"][settings["use"]], settings["curve"]
    spec = _learning(config) | {"garment": garment, "variant": settings["use"], "model": model}
    return canonical(spec | {"curve": curve})


def fine_tune_spec(config: Config, garment: str) -> str:
    """The collision fine-tuning of a garment's regressor."""
    spec = _learning(config) | {"garment": garment, "model": config["models"]["garment_regressor"]["fine_tuning"]}
    spec |= {name: config["motions"][name] for name in ("frames", "fps", "lead_in")}
    rule = SplitRule(**config["data"]["splits"])
    labels = [label for label in motion_labels(config["motions"]) if not rule.holds_out_label(label)]
    return canonical(spec | {"labels": labels, "refinement": config["models"]["refinement"]})


def layer_types(config: Config) -> list[str]:
    """Names of the types of clothing that are layers on the body mesh, in the networks' numbering."""
    return sorted(config["data"]["layers"]["types"])


def layer_garment_spec(config: Config, kind: str) -> str:
    """The outfit of a type of clothing: a T-shirt over pants of its lengths."""
    layers = config["data"]["layers"]
    lengths = layers["types"][kind]
    worn = [
        {"name": "pants", "kind": "pants", "length": lengths["pants"]} | layers["pants"],
        {"name": "shirt", "kind": "tshirt", "sleeve": lengths["sleeve"]} | layers["shirt"],
    ]
    return canonical({"garment": kind, "geometry": {"kind": "outfit", "worn": worn}, "body": config["body"]})


def layer_batches(config: Config) -> list[int]:
    """The motion batches that the layers' clips are in."""
    clips = [clip for number in range(len(layer_types(config))) for clip in layer_clips(config, number)]
    return sorted({clip.index // config["motions"]["clips_per_batch"] for clip in clips})


def layer_simulate_spec(config: Config, kind: str) -> str:
    """The simulations of a type: every sampled body in the outfit graded to it, on its clips."""
    layers, own = config["data"]["layers"], layer_types(config).index(kind)
    pairs = [(body, clip) for body in range(1, layers["bodies"] + 1) for clip in layer_clips(config, own, body)]
    spec = {name: config["motions"][name] for name in ("fps", "lead_in")}
    spec |= {
        "garment": kind,
        "plan": "bodies",
        "seed": config["seed"],
        "body": config["body"],
        "base": base_values(layers),
        "simulations": [[body, clip.name, clip.take_index] for body, clip in pairs],
        "solver": config["simulation"],
        "spread": layers["spread"],
    }
    return canonical(spec)


def layer_transfer_spec(config: Config, kind: str) -> str:
    """A type's simulations brought to the topology of the body."""
    return canonical(_layer_learning(config) | {"garment": kind, "stride": config["data"]["layers"]["frames_stride"]})


def mesh_hierarchy_spec(config: Config) -> str:
    """The levels of the body mesh."""
    return canonical({"body": config["body"], "levels": config["data"]["layers"]["levels"]})


def mesh_vae_gan_spec(config: Config, variant: str) -> str:
    """A training of the Mesh VAE-GAN."""
    variant, number = split_seed(variant)
    spec = _layer_learning(config) | {"types": layer_types(config), "variant": variant}
    spec["seed"] += number - 1
    return canonical(spec | {"model": variant_settings(config["models"]["mesh_vae_gan"]["variants"], variant)})


def evaluate_mesh_vae_gan_spec(config: Config) -> str:
    """The evaluation of all variants of the Mesh VAE-GAN."""
    spec = _layer_learning(config) | {"types": layer_types(config), "use": config["models"]["mesh_vae_gan"]["use"]}
    spec["variants"] = trained_variants(config, "mesh_vae_gan")
    return canonical(spec)


def render_mesh_vae_gan_spec(config: Config) -> str:
    """Pictures of generated layers."""
    return canonical(_layer_learning(config) | {"types": layer_types(config), "report": config["report"]})


def _layer_learning(config: Config) -> dict:
    splits = config["data"]["splits"] | {"bodies_every": config["data"]["layers"]["bodies_every"]}
    return {"seed": config["seed"], "body": config["body"], "splits": splits}


def evaluate_spec(config: Config, garment: str = "", model: str = "") -> str:
    """An evaluation: the split, the settings of the metrics and the names of the variants."""
    spec = _learning(config) | {"evaluation": config["evaluation"], "refinement": config["models"]["refinement"]}
    if not garment:
        models = {name: config["models"][name] for name in ("recognition", "motion_cvae")}
        clips = learning_clips(config["motions"])
        spec |= _labels(config, clips) | models | {"source": config["motions"]["source"]}
        spec["variants"] = trained_variants(config, "motion_cvae")
        return canonical(spec | {name: config["motions"][name] for name in ("frames", "fps")})
    settings = config["models"][model]
    spec |= {"garment": garment, "use": settings["use"], "variants": trained_variants(config, model)}
    if model == "garment_regressor":
        spec["tested_clips"] = [clip.name for clip in tested_clips(config)]
        spec["autoencoders"] = regressing_autoencoders(config)
    return canonical(spec)


def regressing_autoencoders(config: Config) -> list[str]:
    """Variants of the motion-invariant autoencoder that stand beside the regressors: the paper's and the one in use."""
    settings = config["models"]["motion_invariant"]
    return [variant for variant in settings["variants"] if variant in ("paper", settings["use"])]


def garment_name_spec(garment: str) -> str:
    """Of a stage that needs no more than the name of its garment."""
    return canonical({"garment": garment})


def _learning(config: Config) -> dict:
    return {"seed": config["seed"], "body": config["body"], "splits": config["data"]["splits"]}


def _labels(config: Config, clips: list[PlannedClip]) -> dict:
    """The labels in the networks' numbering, and those of the clips that are held out."""
    rule = SplitRule(**config["data"]["splits"])
    held_out = [clip.name for clip in clips if rule.holds_out_take(clip.take_index)]
    return {"labels": sorted({clip.label for clip in clips}), "held_out_clips": held_out}


def timing_spec(config: Config, garment: str) -> str:
    """A timing: solver settings, base parameters and the number of frames."""
    return canonical(
        {
            "garment": garment,
            "body": config["body"],
            "base": base_values(config["garments"][garment]),
            "fps": config["motions"]["fps"],
            "lead_in": config["motions"]["lead_in"],
            "settle": config["simulation"]["settle"],
            "self_contact": config["simulation"]["self_contact"],
            "timing": config["timing"],
            "refinement": config["models"]["refinement"],
        }
    )


def render_spec(config: Config, garment: str) -> str:
    """Pictures and videos of one garment."""
    return canonical(
        _learning(config)
        | {
            "garment": garment,
            "report": config["report"],
            "refinement": config["models"]["refinement"],
        }
        | _labels(config, plan_clips(config["motions"]))
        | {name: config["motions"][name] for name in ("frames", "fps", "lead_in")}
    )


def descriptor_figures_spec(config: Config, garment: str) -> str:
    """Pictures of a garment's shape descriptor."""
    return canonical(_learning(config) | {"garment": garment, "report": config["report"]})


def report_spec(config: Config) -> str:
    """The page prints the whole configuration."""
    return canonical({k: v for k, v in config.items() if k != "compute"})

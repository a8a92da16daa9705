# What the other files of rules share: the checked configuration, the names of things, and the code that each depends on.

import sys
from glob import glob

from pipeline import spec, systems_spec, wardrobe_plan
from pipeline.config import ConfigError, check_config, read_layers, without_nulls
from pipeline.plan import batch_count, learning_batch_count, shard_batches, shard_names
from pipeline.sources import stage_sources

# Snakemake lists the files of the command line first, yet lays them over the default.
overlays = list(workflow.overwrite_configfiles or [])
# What a file takes out with null, Snakemake keeps as null.
config = without_nulls(config)
try:
    check_config(config, read_layers([f for f in workflow.configfiles if f not in overlays] + overlays))
except ConfigError as error:
    sys.stderr.write(f"configuration error: {error}\n")
    sys.stderr.flush()
    sys.exit(1)

RESULTS = f"results/{config['run']}"
GARMENTS = sorted(config["garments"])
WARDROBE = wardrobe_plan.wardrobe_names(config)
LAYERS = f"{RESULTS}/layers"
COMPARED = systems_spec.compared_garment(config)
# Where the work is done, not what comes out: kept out of the parameters, so that a change reruns nothing.
DEVICE = config["compute"]["device"]
THREADS = config["compute"]["threads"]
# For --software-deployment-method conda; without it, the environment that make builds is used.
ENVIRONMENT = "../../envs/drapeline.yaml"


wildcard_constraints:
    garment="|".join(GARMENTS),
    shard=r"(materials|motions|bodies)_\d{4}",
    batch=r"\d{4}",
    variant="|".join(
        v for m, s in config["models"].items() if "variants" in s for v in spec.trained_variants(config, m)
    ),


def shards(wildcards, plans=("materials", "motions")):
    """Shards of a garment; where no plans are named, all that are on the run's own body."""
    return [f"{RESULTS}/shards/{wildcards.garment}/{name}.h5" for name in shard_names(config, plans)]


def body_shards(wildcards):
    """Shards of a garment on sampled bodies; none where the configuration asks for none."""
    return shards(wildcards, ("bodies",))


def test_shards():
    """Path patterns of a garment's simulations that are tested on alone: clips simulated twice, long motions."""
    return [f"{RESULTS}/tests/{{garment}}/{plan}.h5" for plan in ("repeated", "long")]


def batches():
    """All motion batches, those too that are not simulated."""
    return [f"{RESULTS}/motions/batch_{i:04d}.h5" for i in range(learning_batch_count(config["motions"]))]


def motion_cvae(variant=None):
    """Path of a trained motion generator, of the variant in use where none is named."""
    return f"{RESULTS}/models/motion/motion_cvae/{variant or config['models']['motion_cvae']['use']}.pt"


def motion_cvaes():
    """Paths of all variants of the motion generator, in the order of the config."""
    return [motion_cvae(variant) for variant in spec.trained_variants(config, "motion_cvae")]


def motion_trainings():
    """Names of the trainings of the motion models, the judge first."""
    return ["motion/recognition"] + [
        f"motion/motion_cvae/{variant}" for variant in spec.trained_variants(config, "motion_cvae")
    ]


def model_file(model, variant=None):
    """Path of a garment's trained model, of the variant in use where none is named."""
    return f"{RESULTS}/models/{{garment}}/{model}/{variant or config['models'][model]['use']}.pt"


def model_files(model):
    """Paths of all variants of a garment's model and of their repetitions, in the order of the config."""
    return [model_file(model, variant) for variant in spec.trained_variants(config, model)]


def codes_file():
    """Path pattern of a garment's frames as descriptors."""
    return f"{RESULTS}/codes/{{garment}}.h5"


def part(table):
    """Path pattern of one garment's part of a table."""
    return f"{RESULTS}/parts/{table}/{{garment}}.csv"


def losses():
    """The loss tables of all trainings, motion models first."""
    trainings = motion_trainings() + [f"gsnet/{variant}" for variant in spec.trained_variants(config, "gsnet")]
    for garment in GARMENTS:
        for model in ("shape_descriptor", "motion_invariant", "garment_regressor"):
            trainings += [f"{garment}/{model}/{variant}" for variant in spec.trained_variants(config, model)]
    trainings += [f"mesh_vae_gan/{variant}" for variant in spec.trained_variants(config, "mesh_vae_gan")]
    return [f"{RESULTS}/training/{training}/losses.csv" for training in trainings]


def regressor_shards(wildcards):
    """Shards that a regressor is trained on: one that is told of the body sees other bodies too."""
    bodies = body_shards(wildcards) if wildcards.variant.startswith("conditioned") else []
    return shards(wildcards) + bodies


def regressor_descriptor(wildcards):
    """Shape descriptor and codes, of the regressor that predicts codes alone: others need not wait for them."""
    if not wildcards.variant.startswith("descriptor-space"):
        return []
    return [path.format(garment=wildcards.garment) for path in (model_file("shape_descriptor"), codes_file())]


def wardrobe_templates():
    """Templates of all garments of the wardrobe."""
    return [f"{RESULTS}/wardrobe/{name}.npz" for name in WARDROBE]


def wardrobe_shards():
    """Shards of all garments of the wardrobe, in the order of the templates."""
    return [f"{RESULTS}/wardrobe/{name}.h5" for name in WARDROBE]


def gsnet_model(variant):
    """Path of a trained variant."""
    return f"{RESULTS}/models/gsnet/{variant}.pt"


def gsnet_losses(variant):
    """Path of its losses."""
    return f"{RESULTS}/training/gsnet/{variant}/losses.csv"


def layer_files(pattern):
    """Paths of all types, in the networks' numbering."""
    return [f"{LAYERS}/{pattern.format(layer=layer)}" for layer in spec.layer_types(config)]


def mesh_vae_gans():
    """Paths of all variants, in the order of the config."""
    return [f"{RESULTS}/models/mesh_vae_gan/{variant}.pt" for variant in spec.trained_variants(config, "mesh_vae_gan")]


def compared(pattern):
    """Paths that the pattern names for every compared variant of every model, in the order of the stage."""
    return [
        path.format(garment=COMPARED)
        for model in systems_spec.MODELS
        for variant in systems_spec.compared_variants(config, model)
        for path in (pattern(model, variant),)
    ]


def compared_model(model, variant):
    """Path of a trained network."""
    return {"gsnet": gsnet_model, "mesh_vae_gan": lambda v: f"{RESULTS}/models/mesh_vae_gan/{v}.pt"}.get(
        model, lambda v: model_file(model, v)
    )(variant)


def compared_benchmark(model, variant):
    """Path of what its training took."""
    if model in ("gsnet", "mesh_vae_gan"):
        return f"{RESULTS}/benchmarks/train_{model}/{variant}.tsv"
    return f"{RESULTS}/benchmarks/train_{model}/{{garment}}_{model}_{variant}.tsv"

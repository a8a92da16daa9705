# What the other rule files share: the checked configuration, the names of things, and which code a rule depends on.

import sys
from glob import glob

from pipeline import spec
from pipeline.config import ConfigError, check_config, read_layers
from pipeline.plan import batch_count, shard_batches, shard_names

# Snakemake lists the files of the command line first, yet lays them over the default.
overlays = list(workflow.overwrite_configfiles or [])
try:
    check_config(config, read_layers([f for f in workflow.configfiles if f not in overlays] + overlays))
except ConfigError as error:
    sys.stderr.write(f"configuration error: {error}\n")
    sys.stderr.flush()
    sys.exit(1)

RESULTS = f"results/{config['run']}"
GARMENTS = sorted(config["garments"])
# Where the work is done, not what comes out: kept out of the parameters, so that a change reruns nothing.
DEVICE = config["compute"]["device"]
THREADS = config["compute"]["threads"]


wildcard_constraints:
    garment="|".join(GARMENTS),
    shard=r"(materials|motions)_\d{4}",
    batch=r"\d{4}",
    variant="|".join(v for m in config["models"].values() for v in m.get("variants", ())),


def code(*places):
    """Source files that a rule's output depends on: folders (all their modules) and single files."""
    files = []
    for place in places:
        files += sorted(glob(f"{place}/**/*.py", recursive=True)) if not place.endswith(".py") else [place]
    return files


def shards(wildcards):
    """All shards of a garment."""
    return [f"{RESULTS}/shards/{wildcards.garment}/{name}.h5" for name in shard_names(config)]


def batches():
    """All motion batches."""
    return [f"{RESULTS}/motions/batch_{i:04d}.h5" for i in range(batch_count(config["motions"]))]

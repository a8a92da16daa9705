# From sampled materials and motions to simulated cloth, trained models, tables and a report.
# The includes follow the data: rules are in pipeline/rules/, one stage of the paper a file.

from snakemake.utils import min_version

min_version("9.12")


configfile: "configs/default.yaml"


include: "pipeline/rules/common.smk"
include: "pipeline/rules/data.smk"
include: "pipeline/rules/wardrobe.smk"
include: "pipeline/rules/ranges.smk"
include: "pipeline/rules/learn.smk"
include: "pipeline/rules/evaluate.smk"
include: "pipeline/rules/gsnet.smk"
include: "pipeline/rules/mesh_vae_gan.smk"
include: "pipeline/rules/systems.smk"
include: "pipeline/rules/arcsim.smk"
include: "pipeline/rules/report.smk"


# The whole road. The other targets stop on the way: data, models, tables, report; smoke runs everything, tiny.
rule all:
    default_target: True
    input:
        f"{RESULTS}/report.html",
        f"{RESULTS}/config.json",

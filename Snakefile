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


# Snakemake limits how fast jobs are started, and to that end looks again some time after every look it takes: after a
# hundred jobs, a hundred times as often, which takes up to a core; and at the end it waits for the last look. A run on
# this machine needs no such limit: the end of a job starts the next one.
onstart:
    if workflow.local_exec:
        workflow.scheduler.job_rate_limiter = None


# The whole road. The other targets stop on the way: data, models, tables, report; smoke runs everything, tiny.
rule all:
    default_target: True
    input:
        f"{RESULTS}/report.html",
        f"{RESULTS}/config.json",

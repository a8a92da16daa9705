# GSNet (Peng 2023): one network for garments of any topology, and what it is compared with, on the wardrobe.

from pipeline import gsnet_spec

GSNET_VARIANTS = spec.trained_variants(config, "gsnet")
GSNET_TABLES = ["gsnet", "gsnet_categories", "gsnet_gap", "gsnet_stability", "gsnet_contact", "gsnet_drift"]


rule train_gsnet:
    input:
        shards=wardrobe_shards(),
        templates=wardrobe_templates(),
        code=stage_sources("train_gsnet"),
    output:
        model=gsnet_model("{variant}"),
        losses=gsnet_losses("{variant}"),
    log:
        f"{RESULTS}/logs/train_gsnet/{{variant}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/train_gsnet/{{variant}}.tsv"
    priority: 20
    conda:
        ENVIRONMENT
    threads: THREADS
    resources:
        device=DEVICE,
    params:
        spec=lambda w: gsnet_spec.train_gsnet_spec(config, w.variant),
    shell:
        "python -m pipeline.train_gsnet --spec {params.spec:q} --out {output}"
        " --in {input.shards} {input.templates} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule evaluate_gsnet:
    input:
        models=[gsnet_model(variant) for variant in GSNET_VARIANTS],
        losses=[gsnet_losses(variant) for variant in GSNET_VARIANTS],
        long=[
            path
            for garment in GARMENTS
            for path in (f"{RESULTS}/garments/{garment}.npz", f"{RESULTS}/tests/{garment}/long.h5")
        ],
        shards=wardrobe_shards(),
        templates=wardrobe_templates(),
        code=stage_sources("evaluate_gsnet"),
    output:
        [f"{RESULTS}/tables/{table}.csv" for table in GSNET_TABLES],
    log:
        f"{RESULTS}/logs/evaluate_gsnet.log",
    benchmark:
        f"{RESULTS}/benchmarks/evaluate_gsnet.tsv"
    conda:
        ENVIRONMENT
    threads: THREADS
    resources:
        device=DEVICE,
    params:
        spec=gsnet_spec.evaluate_gsnet_spec(config),
    shell:
        "python -m pipeline.evaluate_gsnet --spec {params.spec:q} --out {output} --in {input.models} {input.losses}"
        " {input.long} {input.shards} {input.templates} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


# Alone on the machine: it takes all cores, though each thing that it times uses one.
rule time_gsnet:
    input:
        model=gsnet_model(config["models"]["gsnet"]["use"]),
        motions=f"{RESULTS}/motions/batch_0000.h5",
        templates=[f"{RESULTS}/wardrobe/{name}.npz" for name in gsnet_spec.timed_templates(config)],
        kernels=ancient(f"{RESULTS}/.kernels_compiled"),
        code=stage_sources("time_gsnet"),
    output:
        f"{RESULTS}/tables/gsnet_timing.csv",
    log:
        f"{RESULTS}/logs/time_gsnet.log",
    benchmark:
        f"{RESULTS}/benchmarks/time_gsnet.tsv"
    conda:
        ENVIRONMENT
    threads: workflow.cores
    resources:
        device=DEVICE,
    params:
        spec=gsnet_spec.time_gsnet_spec(config),
    shell:
        "python -m pipeline.time_gsnet --spec {params.spec:q} --out {output} --in {input.model} {input.motions}"
        " {input.templates} --device {resources.device} --threads 1 2>&1 | tee {log}"


rule render_gsnet:
    input:
        models=[gsnet_model(variant) for variant in gsnet_spec.drawn_networks(config)],
        shards=wardrobe_shards(),
        templates=wardrobe_templates(),
        code=stage_sources("render_gsnet"),
    output:
        directory(f"{RESULTS}/figures/gsnet"),
    log:
        f"{RESULTS}/logs/render_gsnet.log",
    benchmark:
        f"{RESULTS}/benchmarks/render_gsnet.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=gsnet_spec.render_gsnet_spec(config),
    shell:
        "python -m pipeline.render_gsnet --spec {params.spec:q} --out {output}"
        " --in {input.models} {input.shards} {input.templates} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


# These write whole tables themselves, nothing is left to join.
ruleorder: evaluate_gsnet > table
ruleorder: time_gsnet > table


rule gsnet:
    input:
        rules.evaluate_gsnet.output,
        rules.time_gsnet.output,
        rules.render_gsnet.output,

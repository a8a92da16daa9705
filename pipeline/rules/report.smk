# Pictures and the page.


rule render:
    input:
        template=f"{RESULTS}/garments/{{garment}}.npz",
        shards=shards,
        cvae=motion_cvae(),
        regressor=model_file("garment_regressor", "fine_tuned"),
        code=stage_sources("render"),
    output:
        directory(f"{RESULTS}/figures/{{garment}}"),
    log:
        f"{RESULTS}/logs/render/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/render/{{garment}}.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.render_spec(config, w.garment),
    shell:
        "python -m pipeline.render --spec {params.spec:q} --out {output} --in {input.template} {input.cvae}"
        " {input.regressor} {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule render_descriptor:
    input:
        template=f"{RESULTS}/garments/{{garment}}.npz",
        shards=shards,
        curve=f"{RESULTS}/models/{{garment}}/shape_descriptor_curve",
        descriptor=model_file("shape_descriptor"),
        code=stage_sources("render_descriptor"),
    output:
        directory(f"{RESULTS}/figures/{{garment}}_descriptor"),
    log:
        f"{RESULTS}/logs/render_descriptor/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/render_descriptor/{{garment}}.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.descriptor_figures_spec(config, w.garment),
    shell:
        "python -m pipeline.render_descriptor --spec {params.spec:q} --out {output} --in {input.template} {input.curve}"
        " {input.descriptor} {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule report:
    input:
        tables=rules.tables.input,
        figures=expand(f"{RESULTS}/figures/{{garment}}{{of}}", garment=GARMENTS, of=["", "_descriptor"])
        + [f"{RESULTS}/figures/{network}" for network in ("mesh_vae_gan", "gsnet")]
        + ([f"{RESULTS}/figures/systems"] if COMPARED else []),
        losses=losses(),
        code=stage_sources("report"),
    output:
        report(f"{RESULTS}/report.html", category="Report"),
    log:
        f"{RESULTS}/logs/report.log",
    conda:
        ENVIRONMENT
    params:
        spec=spec.report_spec(config),
        results=lambda w, output: output[0].rsplit("/", 1)[0],
    shell:
        "python -m pipeline.report --spec {params.spec:q} --out {output} --in {params.results} 2>&1 | tee {log}"


# The same road on tiny meshes, as a run of its own.
rule smoke:
    log:
        "results/smoke.log",
    conda:
        ENVIRONMENT
    threads: workflow.cores
    shell:
        "snakemake all --configfile configs/smoke.yaml --cores {threads} 2>&1 | tee {log}"

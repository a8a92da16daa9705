# The wardrobe: garments of all categories, built and simulated for networks that dress any garment.


rule simulate_wardrobe:
    input:
        motions=lambda w: [
            f"{RESULTS}/motions/batch_{i:04d}.h5" for i in wardrobe_plan.template_batches(config, w.template)
        ],
        kernels=ancient(f"{RESULTS}/.kernels_compiled"),
        code=stage_sources("simulate_wardrobe"),
    output:
        template=f"{RESULTS}/wardrobe/{{template}}.npz",
        shard=ensure(f"{RESULTS}/wardrobe/{{template}}.h5", non_empty=True),
    log:
        f"{RESULTS}/logs/wardrobe/{{template}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/wardrobe/{{template}}.tsv"
    wildcard_constraints:
        template="|".join(WARDROBE),
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=lambda w: wardrobe_plan.wardrobe_spec(config, w.template),
    shell:
        "python -m pipeline.simulate_wardrobe --spec {params.spec:q} --out {output.template} {output.shard}"
        " --in {input.motions} --device {resources.device} 2>&1 | tee {log}"


rule wardrobe:
    input:
        wardrobe_templates(),
        wardrobe_shards(),

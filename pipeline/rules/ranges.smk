# How far each intrinsic parameter can go: a target of its own, for its result is a configuration, not data.


rule find_ranges:
    input:
        template=f"{RESULTS}/garments/{{garment}}.npz",
        motions=f"{RESULTS}/motions/batch_0000.h5",
        kernels=ancient(f"{RESULTS}/.kernels_compiled"),
        code=stage_sources("find_ranges"),
    output:
        fragment=f"{RESULTS}/ranges/{{garment}}.yaml",
        trials=f"{RESULTS}/ranges/{{garment}}.csv",
        plot=f"{RESULTS}/ranges/{{garment}}.svg",
    log:
        f"{RESULTS}/logs/find_ranges/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/find_ranges/{{garment}}.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.ranges_spec(config, w.garment),
    shell:
        "python -m pipeline.find_ranges --spec {params.spec:q} --out {output} --in {input.template} {input.motions}"
        " --device {resources.device} 2>&1 | tee {log}"


rule ranges:
    input:
        expand(f"{RESULTS}/ranges/{{garment}}.yaml", garment=GARMENTS),

# From parameters and motions to shards of simulated cloth.


rule compile_kernels:
    input:
        code=stage_sources("compile_kernels"),
        kernels=glob("sim/kernels/*.py") + glob("sim/implicit/*.py"),
    output:
        touch(f"{RESULTS}/.kernels_compiled"),
    log:
        f"{RESULTS}/logs/compile_kernels.log",
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    shell:
        "python -m pipeline.compile_kernels --spec null --out {output} --device {resources.device} 2>&1 | tee {log}"


rule garment:
    input:
        mesh=lambda w: spec.garment_files(config, w.garment),
        code=stage_sources("make_garment"),
    output:
        f"{RESULTS}/garments/{{garment}}.npz",
    log:
        f"{RESULTS}/logs/garment/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/garment/{{garment}}.tsv"
    conda:
        ENVIRONMENT
    params:
        spec=lambda w: spec.garment_spec(config, w.garment),
    shell:
        "python -m pipeline.make_garment --spec {params.spec:q} --out {output} --in {input.mesh:q} 2>&1 | tee {log}"


rule motions:
    input:
        code=stage_sources("make_motions"),
    output:
        f"{RESULTS}/motions/batch_{{batch}}.h5",
    log:
        f"{RESULTS}/logs/motions/{{batch}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/motions/{{batch}}.tsv"
    conda:
        ENVIRONMENT
    params:
        spec=lambda w: spec.motions_spec(config, int(w.batch)),
    shell:
        "python -m pipeline.make_motions --spec {params.spec:q} --out {output} 2>&1 | tee {log}"


rule simulate:
    input:
        template=f"{RESULTS}/garments/{{garment}}.npz",
        motions=lambda w: [f"{RESULTS}/motions/batch_{i:04d}.h5" for i in shard_batches(config, w.shard)],
        kernels=ancient(f"{RESULTS}/.kernels_compiled"),
        code=stage_sources("simulate"),
    output:
        ensure(f"{RESULTS}/shards/{{garment}}/{{shard}}.h5", non_empty=True),
    log:
        f"{RESULTS}/logs/simulate/{{garment}}_{{shard}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/simulate/{{garment}}_{{shard}}.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.simulate_spec(config, w.garment, w.shard),
    shell:
        "python -m pipeline.simulate --spec {params.spec:q} --out {output} --in {input.template} {input.motions}"
        " --device {resources.device} 2>&1 | tee {log}"


# Held-out clips once more, and long motions: nobody trains on these.
rule simulate_tests:
    input:
        template=f"{RESULTS}/garments/{{garment}}.npz",
        motions=lambda w: [f"{RESULTS}/motions/batch_{i:04d}.h5" for i in range(batch_count(config["motions"]))],
        kernels=ancient(f"{RESULTS}/.kernels_compiled"),
        code=stage_sources("simulate_tests"),
    output:
        test_shards(),
    log:
        f"{RESULTS}/logs/simulate_tests/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/simulate_tests/{{garment}}.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.tests_spec(config, w.garment),
    shell:
        "python -m pipeline.simulate_tests --spec {params.spec:q} --out {output} --in {input.template} {input.motions}"
        " --device {resources.device} 2>&1 | tee {log}"


rule data:
    input:
        expand(f"{RESULTS}/shards/{{garment}}/{{shard}}.h5", garment=GARMENTS, shard=shard_names(config)),

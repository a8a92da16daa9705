# Clothing as a layer on the body mesh (Ma 2019): outfits simulated on sampled bodies, brought to the body's topology,
# learned by a conditional Mesh VAE-GAN.


wildcard_constraints:
    layer="|".join(spec.layer_types(config)),


rule layer_garment:
    input:
        code=stage_sources("make_garment"),
    output:
        f"{LAYERS}/garments/{{layer}}.npz",
    log:
        f"{RESULTS}/logs/layer_garment/{{layer}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/layer_garment/{{layer}}.tsv"
    conda:
        ENVIRONMENT
    params:
        spec=lambda w: spec.layer_garment_spec(config, w.layer),
    shell:
        "python -m pipeline.make_garment --spec {params.spec:q} --out {output} 2>&1 | tee {log}"


rule layer_simulate:
    input:
        template=f"{LAYERS}/garments/{{layer}}.npz",
        motions=[f"{RESULTS}/motions/batch_{i:04d}.h5" for i in spec.layer_batches(config)],
        kernels=ancient(f"{RESULTS}/.kernels_compiled"),
        code=stage_sources("simulate"),
    output:
        ensure(f"{LAYERS}/shards/{{layer}}.h5", non_empty=True),
    log:
        f"{RESULTS}/logs/layer_simulate/{{layer}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/layer_simulate/{{layer}}.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.layer_simulate_spec(config, w.layer),
    shell:
        "python -m pipeline.simulate --spec {params.spec:q} --out {output} --in {input.template} {input.motions}"
        " --device {resources.device} 2>&1 | tee {log}"


rule layer_transfer:
    input:
        template=f"{LAYERS}/garments/{{layer}}.npz",
        shard=f"{LAYERS}/shards/{{layer}}.h5",
        code=stage_sources("transfer_layer"),
    output:
        layer=f"{LAYERS}/data/{{layer}}.h5",
        table=f"{RESULTS}/parts/layer_transfer/{{layer}}.csv",
    log:
        f"{RESULTS}/logs/layer_transfer/{{layer}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/layer_transfer/{{layer}}.tsv"
    conda:
        ENVIRONMENT
    params:
        spec=lambda w: spec.layer_transfer_spec(config, w.layer),
    shell:
        "python -m pipeline.transfer_layer --spec {params.spec:q} --out {output} --in {input.template} {input.shard}"
        " 2>&1 | tee {log}"


rule mesh_hierarchy:
    input:
        templates=layer_files("garments/{layer}.npz"),
        code=stage_sources("build_mesh_hierarchy"),
    output:
        f"{LAYERS}/hierarchy.npz",
    log:
        f"{RESULTS}/logs/mesh_hierarchy.log",
    benchmark:
        f"{RESULTS}/benchmarks/mesh_hierarchy.tsv"
    conda:
        ENVIRONMENT
    params:
        spec=spec.mesh_hierarchy_spec(config),
    shell:
        "python -m pipeline.build_mesh_hierarchy --spec {params.spec:q} --out {output} --in {input.templates}"
        " 2>&1 | tee {log}"


rule train_mesh_vae_gan:
    input:
        hierarchy=f"{LAYERS}/hierarchy.npz",
        layers=layer_files("data/{layer}.h5"),
        code=stage_sources("train_mesh_vae_gan"),
    output:
        model=f"{RESULTS}/models/mesh_vae_gan/{{variant}}.pt",
        losses=f"{RESULTS}/training/mesh_vae_gan/{{variant}}/losses.csv",
    log:
        f"{RESULTS}/logs/train_mesh_vae_gan/{{variant}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/train_mesh_vae_gan/{{variant}}.tsv"
    conda:
        ENVIRONMENT
    threads: THREADS
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.mesh_vae_gan_spec(config, w.variant),
    shell:
        "python -m pipeline.train_mesh_vae_gan --spec {params.spec:q} --out {output}"
        " --in {input.hierarchy} {input.layers} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule evaluate_mesh_vae_gan:
    input:
        layers=layer_files("data/{layer}.h5"),
        models=mesh_vae_gans(),
        code=stage_sources("evaluate_mesh_vae_gan"),
    output:
        f"{RESULTS}/tables/mesh_vae_gan.csv",
        f"{RESULTS}/tables/mesh_vae_gan_generation.csv",
    log:
        f"{RESULTS}/logs/evaluate_mesh_vae_gan.log",
    benchmark:
        f"{RESULTS}/benchmarks/evaluate_mesh_vae_gan.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=spec.evaluate_mesh_vae_gan_spec(config),
    shell:
        "python -m pipeline.evaluate_mesh_vae_gan --spec {params.spec:q} --out {output}"
        " --in {input.models} {input.layers} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule layer_transfer_table:
    input:
        parts=[f"{RESULTS}/parts/layer_transfer/{layer}.csv" for layer in spec.layer_types(config)],
        code=stage_sources("join_tables"),
    output:
        f"{RESULTS}/tables/layer_transfer.csv",
    log:
        f"{RESULTS}/logs/layer_transfer_table.log",
    conda:
        ENVIRONMENT
    shell:
        "python -m pipeline.join_tables --spec null --out {output} --in {input.parts} 2>&1 | tee {log}"


rule render_mesh_vae_gan:
    input:
        templates=layer_files("garments/{layer}.npz"),
        layers=layer_files("data/{layer}.h5"),
        model=f"{RESULTS}/models/mesh_vae_gan/{config['models']['mesh_vae_gan']['use']}.pt",
        code=stage_sources("render_mesh_vae_gan"),
    output:
        directory(f"{RESULTS}/figures/mesh_vae_gan"),
    log:
        f"{RESULTS}/logs/render_mesh_vae_gan.log",
    benchmark:
        f"{RESULTS}/benchmarks/render_mesh_vae_gan.tsv"
    conda:
        ENVIRONMENT
    params:
        spec=spec.render_mesh_vae_gan_spec(config),
    shell:
        "python -m pipeline.render_mesh_vae_gan --spec {params.spec:q} --out {output} --in {input.model}"
        " {input.templates} {input.layers} 2>&1 | tee {log}"


# These tables have rules of their own.
ruleorder: evaluate_mesh_vae_gan > table
ruleorder: layer_transfer_table > table


rule mesh_vae_gan:
    input:
        f"{RESULTS}/tables/mesh_vae_gan.csv",
        f"{RESULTS}/tables/layer_transfer.csv",
        f"{RESULTS}/figures/mesh_vae_gan",

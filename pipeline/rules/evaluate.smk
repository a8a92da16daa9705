# Tables: each evaluation writes its own part for one garment; `tables` lays the parts of a table together.


rule evaluate_simulation:
    input:
        shards=lambda w: shards(w) + body_shards(w),
        code=stage_sources("evaluate_simulation"),
    output:
        part("simulation"),
        part("dropped"),
    log:
        f"{RESULTS}/logs/evaluate_simulation/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/evaluate_simulation/{{garment}}.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.garment_name_spec(w.garment),
    shell:
        "python -m pipeline.evaluate_simulation --spec {params.spec:q} --out {output}"
        " --in {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule evaluate_shape_descriptor:
    input:
        shards=shards,
        template=f"{RESULTS}/garments/{{garment}}.npz",
        curve=f"{RESULTS}/models/{{garment}}/shape_descriptor_curve",
        models=model_files("shape_descriptor"),
        code=stage_sources("evaluate_shape_descriptor"),
    output:
        part("shape_descriptor"),
        part("descriptor_interpolation"),
        part("descriptor_projection"),
    log:
        f"{RESULTS}/logs/evaluate_shape_descriptor/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/evaluate_shape_descriptor/{{garment}}.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.evaluate_spec(config, w.garment, "shape_descriptor"),
    shell:
        "python -m pipeline.evaluate_shape_descriptor --spec {params.spec:q} --out {output}"
        " --in {input.template} {input.curve} {input.models} {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule evaluate_motion_invariant:
    input:
        shards=shards,
        descriptor=model_file("shape_descriptor"),
        codes=codes_file(),
        models=model_files("motion_invariant"),
        code=stage_sources("evaluate_motion_invariant"),
    output:
        part("motion_invariant"),
        part("parameter_recovery"),
    log:
        f"{RESULTS}/logs/evaluate_motion_invariant/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/evaluate_motion_invariant/{{garment}}.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.evaluate_spec(config, w.garment, "motion_invariant"),
    shell:
        "python -m pipeline.evaluate_motion_invariant --spec {params.spec:q} --out {output}"
        " --in {input.descriptor} {input.codes} {input.models} {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule evaluate_composition:
    input:
        shards=lambda w: shards(w, ("materials",)),
        descriptor=model_file("shape_descriptor"),
        codes=codes_file(),
        motion_invariant=model_file("motion_invariant"),
        long=test_shards()[1],
        code=stage_sources("evaluate_composition"),
    output:
        part("composition"),
        part("inference"),
    log:
        f"{RESULTS}/logs/evaluate_composition/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/evaluate_composition/{{garment}}.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.encode_spec(config, w.garment),
    shell:
        "python -m pipeline.evaluate_composition --spec {params.spec:q} --out {output}"
        " --in {input.descriptor} {input.codes} {input.motion_invariant} {input.long} {input.shards}"
        " --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule evaluate_motion:
    input:
        motions=batches(),
        recognition=f"{RESULTS}/models/motion/recognition.pt",
        models=motion_cvaes(),
        losses=[f"{RESULTS}/training/{training}/losses.csv" for training in motion_trainings()],
        code=stage_sources("evaluate_motion"),
    output:
        f"{RESULTS}/tables/motion_reconstruction.csv",
        f"{RESULTS}/tables/motion_generation.csv",
        f"{RESULTS}/tables/motion_quality.csv",
    log:
        f"{RESULTS}/logs/evaluate_motion.log",
    benchmark:
        f"{RESULTS}/benchmarks/evaluate_motion.tsv"
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=spec.evaluate_spec(config),
    shell:
        "python -m pipeline.evaluate_motion --spec {params.spec:q} --out {output}"
        " --in {input.recognition} {input.models} {input.losses} {input.motions} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule evaluate_garment_regressor:
    input:
        shards=lambda w: shards(w) + body_shards(w),
        template=f"{RESULTS}/garments/{{garment}}.npz",
        fine_tuned=model_file("garment_regressor", "fine_tuned"),
        descriptor=model_file("shape_descriptor"),
        codes=codes_file(),
        autoencoders=[model_file("motion_invariant", v) for v in spec.regressing_autoencoders(config)],
        models=model_files("garment_regressor"),
        tests=test_shards(),
        code=stage_sources("evaluate_garment_regressor"),
    output:
        part("garment_regressor"),
        part("regressor_drift"),
    log:
        f"{RESULTS}/logs/evaluate_garment_regressor/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/evaluate_garment_regressor/{{garment}}.tsv"
    # The longest evaluation: it must not be what is left over for one core at the end.
    priority: 50
    conda:
        ENVIRONMENT
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.evaluate_spec(config, w.garment, "garment_regressor"),
    shell:
        "python -m pipeline.evaluate_garment_regressor --spec {params.spec:q} --out {output}"
        " --in {input.template} {input.fine_tuned} {input.descriptor} {input.codes} {input.autoencoders} {input.models}"
        " {input.tests} {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


# Alone on the machine: it takes all cores, though each thing that it times uses one.
rule time_solvers:
    input:
        template=f"{RESULTS}/garments/{{garment}}.npz",
        motions=f"{RESULTS}/motions/batch_0000.h5",
        kernels=ancient(f"{RESULTS}/.kernels_compiled"),
        descriptor=model_file("shape_descriptor"),
        motion_invariant=model_file("motion_invariant"),
        cvae=motion_cvae(),
        regressor=model_file("garment_regressor", "fine_tuned"),
        code=stage_sources("time_solvers"),
    output:
        part("timing"),
    log:
        f"{RESULTS}/logs/time_solvers/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/time_solvers/{{garment}}.tsv"
    conda:
        ENVIRONMENT
    threads: workflow.cores
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.timing_spec(config, w.garment),
    shell:
        "python -m pipeline.time_solvers --spec {params.spec:q} --out {output} --in {input.template} {input.motions}"
        " {input.descriptor} {input.motion_invariant} {input.cvae} {input.regressor}"
        " --device {resources.device} --threads 1 2>&1 | tee {log}"


rule table:
    input:
        parts=lambda w: expand(part(w.table), garment=GARMENTS),
        code=stage_sources("join_tables"),
    output:
        f"{RESULTS}/tables/{{table}}.csv",
    log:
        f"{RESULTS}/logs/table/{{table}}.log",
    conda:
        ENVIRONMENT
    shell:
        "python -m pipeline.join_tables --spec null --out {output} --in {input.parts} 2>&1 | tee {log}"


# motion_* come from rules of their own.
ruleorder: evaluate_motion > table


TABLES = [
    "simulation",
    "dropped",
    "shape_descriptor",
    "descriptor_interpolation",
    "descriptor_projection",
    "motion_invariant",
    "parameter_recovery",
    "composition",
    "inference",
    "motion_reconstruction",
    "motion_generation",
    "motion_quality",
    "garment_regressor",
    "regressor_drift",
    "collision_tuning",
    "timing",
    "gsnet",
    "gsnet_categories",
    "gsnet_gap",
    "gsnet_stability",
    "gsnet_contact",
    "gsnet_drift",
    "gsnet_timing",
    "mesh_vae_gan",
    "mesh_vae_gan_generation",
    "layer_transfer",
] + (["systems"] if config["systems"]["garment"] else [])


rule tables:
    input:
        expand(f"{RESULTS}/tables/{{table}}.csv", table=TABLES),

# The papers' networks, in their order: shape descriptor, motion-invariant autoencoder (Wang 2019), motion CVAE and
# garment regressor (Shi 2023). The recognition network is the judge of generated motions. Each variant is trained of
# its own; the evaluation shows them all, and later stages use the one that the config names.
# Training checkpoints lie beside the declared outputs, so that a killed job continues where it was.


rule train_shape_descriptor:
    input:
        shards=shards,
        template=f"{RESULTS}/garments/{{garment}}.npz",
        code=stage_sources("train_shape_descriptor"),
    output:
        model=f"{RESULTS}/models/{{garment}}/shape_descriptor/{{variant}}.pt",
        losses=f"{RESULTS}/training/{{garment}}/shape_descriptor/{{variant}}/losses.csv",
    log:
        f"{RESULTS}/logs/train_shape_descriptor/{{garment}}_shape_descriptor_{{variant}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/train_shape_descriptor/{{garment}}_shape_descriptor_{{variant}}.tsv"
    priority: 40
    conda:
        ENVIRONMENT
    threads: THREADS
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.train_spec(config, "shape_descriptor", w.garment, w.variant),
    shell:
        "python -m pipeline.train_shape_descriptor --spec {params.spec:q} --out {output}"
        " --in {input.template} {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule train_descriptor_curve:
    input:
        shards=shards,
        template=f"{RESULTS}/garments/{{garment}}.npz",
        code=stage_sources("train_descriptor_curve"),
    output:
        directory(f"{RESULTS}/models/{{garment}}/shape_descriptor_curve"),
    log:
        f"{RESULTS}/logs/train_descriptor_curve/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/train_descriptor_curve/{{garment}}.tsv"
    priority: 10
    conda:
        ENVIRONMENT
    threads: THREADS
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.curve_spec(config, w.garment),
    shell:
        "python -m pipeline.train_descriptor_curve --spec {params.spec:q} --out {output}"
        " --in {input.template} {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule encode_shapes:
    input:
        shards=shards,
        descriptor=model_file("shape_descriptor"),
        code=stage_sources("encode_shapes"),
    output:
        codes_file(),
    log:
        f"{RESULTS}/logs/encode_shapes/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/encode_shapes/{{garment}}.tsv"
    priority: 35
    conda:
        ENVIRONMENT
    threads: THREADS
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.encode_spec(config, w.garment),
    shell:
        "python -m pipeline.encode_shapes --spec {params.spec:q} --out {output}"
        " --in {input.descriptor} {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule train_motion_invariant:
    input:
        codes=codes_file(),
        descriptor=model_file("shape_descriptor"),
        code=stage_sources("train_motion_invariant"),
    output:
        model=f"{RESULTS}/models/{{garment}}/motion_invariant/{{variant}}.pt",
        losses=f"{RESULTS}/training/{{garment}}/motion_invariant/{{variant}}/losses.csv",
    log:
        f"{RESULTS}/logs/train_motion_invariant/{{garment}}_motion_invariant_{{variant}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/train_motion_invariant/{{garment}}_motion_invariant_{{variant}}.tsv"
    priority: 30
    conda:
        ENVIRONMENT
    threads: THREADS
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.train_spec(config, "motion_invariant", w.garment, w.variant),
    shell:
        "python -m pipeline.train_motion_invariant --spec {params.spec:q} --out {output}"
        " --in {input.codes} {input.descriptor} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule train_recognition:
    input:
        motions=batches(),
        code=stage_sources("train_recognition"),
    output:
        model=f"{RESULTS}/models/motion/recognition.pt",
        losses=f"{RESULTS}/training/motion/recognition/losses.csv",
    log:
        f"{RESULTS}/logs/train_recognition/recognition.log",
    benchmark:
        f"{RESULTS}/benchmarks/train_recognition/recognition.tsv"
    priority: 20
    conda:
        ENVIRONMENT
    threads: THREADS
    resources:
        device=DEVICE,
    params:
        spec=spec.train_spec(config, "recognition"),
    shell:
        "python -m pipeline.train_recognition --spec {params.spec:q} --out {output}"
        " --in {input.motions} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule train_motion_cvae:
    input:
        motions=batches(),
        code=stage_sources("train_motion_cvae"),
    output:
        model=motion_cvae("{variant}"),
        losses=f"{RESULTS}/training/motion/motion_cvae/{{variant}}/losses.csv",
    log:
        f"{RESULTS}/logs/train_motion_cvae/{{variant}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/train_motion_cvae/{{variant}}.tsv"
    priority: 20
    conda:
        ENVIRONMENT
    threads: THREADS
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.train_spec(config, "motion_cvae", variant=w.variant),
    shell:
        "python -m pipeline.train_motion_cvae --spec {params.spec:q} --out {output}"
        " --in {input.motions} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule train_garment_regressor:
    input:
        shards=regressor_shards,
        template=f"{RESULTS}/garments/{{garment}}.npz",
        descriptor=regressor_descriptor,
        code=stage_sources("train_garment_regressor"),
    output:
        model=f"{RESULTS}/models/{{garment}}/garment_regressor/{{variant}}.pt",
        losses=f"{RESULTS}/training/{{garment}}/garment_regressor/{{variant}}/losses.csv",
    log:
        f"{RESULTS}/logs/train_garment_regressor/{{garment}}_garment_regressor_{{variant}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/train_garment_regressor/{{garment}}_garment_regressor_{{variant}}.tsv"
    priority: 10
    conda:
        ENVIRONMENT
    threads: THREADS
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.train_spec(config, "garment_regressor", w.garment, w.variant),
    shell:
        "python -m pipeline.train_garment_regressor --spec {params.spec:q} --out {output}"
        " --in {input.template} {input.descriptor} {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


# Shi 2023, section 3.4: without ground truth, on motions that the CVAE invents, so the CVAE comes before it.
rule fine_tune_regressor:
    input:
        regressor=model_file("garment_regressor"),
        cvae=motion_cvae(),
        template=f"{RESULTS}/garments/{{garment}}.npz",
        code=stage_sources("fine_tune_regressor"),
    output:
        model=f"{RESULTS}/models/{{garment}}/garment_regressor/fine_tuned.pt",
        table=f"{RESULTS}/parts/collision_tuning/{{garment}}.csv",
    log:
        f"{RESULTS}/logs/fine_tune_regressor/{{garment}}.log",
    benchmark:
        f"{RESULTS}/benchmarks/fine_tune_regressor/{{garment}}.tsv"
    priority: 10
    conda:
        ENVIRONMENT
    threads: THREADS
    resources:
        device=DEVICE,
    params:
        spec=lambda w: spec.fine_tune_spec(config, w.garment),
    shell:
        "python -m pipeline.fine_tune_regressor --spec {params.spec:q} --out {output} --in {input.template} {input.cvae}"
        " {input.regressor} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


# For those who use the models: the commands read from it what the run holds.
rule record_config:
    input:
        code=stage_sources("record_config"),
    output:
        f"{RESULTS}/config.json",
    log:
        f"{RESULTS}/logs/record_config.log",
    conda:
        ENVIRONMENT
    params:
        spec=spec.run_spec(config),
    shell:
        "python -m pipeline.record_config --spec {params.spec:q} --out {output} 2>&1 | tee {log}"


rule models:
    input:
        f"{RESULTS}/config.json",
        [
            path.format(garment=garment)
            for garment in GARMENTS
            for model in ("shape_descriptor", "motion_invariant", "garment_regressor")
            for path in model_files(model)
        ],
        expand(f"{RESULTS}/models/{{garment}}/garment_regressor/fine_tuned.pt", garment=GARMENTS),
        motion_cvaes(),
        f"{RESULTS}/models/motion/recognition.pt",

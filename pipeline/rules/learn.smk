# The papers' networks, in their order: shape descriptor, motion-invariant autoencoder (Wang 2019), motion CVAE and
# garment regressor (Shi 2023). The recognition network is the judge of generated motions.
# Training checkpoints lie beside the declared outputs, so that a killed job continues where it was.


rule train_shape_descriptor:
    input:
        shards=shards,
        template=f"{RESULTS}/garments/{{garment}}.npz",
        code=code("models/training.py", "models/shape_descriptor.py", "models/shape_code.py", "datasets", "pipeline/train_shape_descriptor.py"),
    output:
        model=f"{RESULTS}/models/{{garment}}/shape_descriptor.pt",
        losses=f"{RESULTS}/training/{{garment}}/shape_descriptor/losses.csv",
    log:
        f"{RESULTS}/logs/train/{{garment}}_shape_descriptor.log",
    benchmark:
        f"{RESULTS}/benchmarks/train/{{garment}}_shape_descriptor.tsv"
    params:
        spec=lambda w: spec.train_spec(config, "shape_descriptor", w.garment),
    priority: 40
    threads: THREADS
    resources:
        device=DEVICE,
    shell:
        "python -m pipeline.train_shape_descriptor --spec {params.spec:q} --out {output} --in {input.template}"
        " {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule train_motion_invariant:
    input:
        shards=shards,
        descriptor=f"{RESULTS}/models/{{garment}}/shape_descriptor.pt",
        code=code("models/training.py", "models/motion_invariant.py", "datasets", "pipeline/train_motion_invariant.py"),
    output:
        model=f"{RESULTS}/models/{{garment}}/motion_invariant.pt",
        losses=f"{RESULTS}/training/{{garment}}/motion_invariant/losses.csv",
    log:
        f"{RESULTS}/logs/train/{{garment}}_motion_invariant.log",
    benchmark:
        f"{RESULTS}/benchmarks/train/{{garment}}_motion_invariant.tsv"
    params:
        spec=lambda w: spec.train_spec(config, "motion_invariant", w.garment),
    priority: 30
    threads: THREADS
    resources:
        device=DEVICE,
    shell:
        "python -m pipeline.train_motion_invariant --spec {params.spec:q} --out {output} --in {input.descriptor}"
        " {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule train_recognition:
    input:
        motions=batches(),
        code=code("models/training.py", "models/recognition.py", "pipeline/train_recognition.py"),
    output:
        model=f"{RESULTS}/models/motion/recognition.pt",
        losses=f"{RESULTS}/training/motion/recognition/losses.csv",
    log:
        f"{RESULTS}/logs/train/recognition.log",
    benchmark:
        f"{RESULTS}/benchmarks/train/recognition.tsv"
    params:
        spec=spec.train_spec(config, "recognition"),
    priority: 10
    threads: THREADS
    resources:
        device=DEVICE,
    shell:
        "python -m pipeline.train_recognition --spec {params.spec:q} --out {output} --in {input.motions}"
        " --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule train_motion_cvae:
    input:
        motions=batches(),
        code=code("models/training.py", "models/motion_cvae.py", "models/transformer.py", "models/body_layer.py", "pipeline/train_motion_cvae.py"),
    output:
        model=f"{RESULTS}/models/motion/motion_cvae.pt",
        losses=f"{RESULTS}/training/motion/motion_cvae/losses.csv",
    log:
        f"{RESULTS}/logs/train/motion_cvae.log",
    benchmark:
        f"{RESULTS}/benchmarks/train/motion_cvae.tsv"
    params:
        spec=spec.train_spec(config, "motion_cvae"),
    priority: 20
    threads: THREADS
    resources:
        device=DEVICE,
    shell:
        "python -m pipeline.train_motion_cvae --spec {params.spec:q} --out {output} --in {input.motions}"
        " --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule train_garment_regressor:
    input:
        shards=shards,
        template=f"{RESULTS}/garments/{{garment}}.npz",
        cvae=f"{RESULTS}/models/motion/motion_cvae.pt",
        code=code("models", "datasets", "pipeline/train_garment_regressor.py"),
    output:
        model=f"{RESULTS}/models/{{garment}}/garment_regressor.pt",
        losses=f"{RESULTS}/training/{{garment}}/garment_regressor/losses.csv",
    log:
        f"{RESULTS}/logs/train/{{garment}}_garment_regressor.log",
    benchmark:
        f"{RESULTS}/benchmarks/train/{{garment}}_garment_regressor.tsv"
    params:
        spec=lambda w: spec.train_spec(config, "garment_regressor", w.garment),
    priority: 10
    threads: THREADS
    resources:
        device=DEVICE,
    shell:
        "python -m pipeline.train_garment_regressor --spec {params.spec:q} --out {output} --in {input.template}"
        " {input.cvae} {input.shards} --device {resources.device} --threads {threads} 2>&1 | tee {log}"


rule models:
    input:
        expand(
            f"{RESULTS}/models/{{garment}}/{{model}}.pt",
            garment=GARMENTS,
            model=["shape_descriptor", "motion_invariant", "garment_regressor"],
        ),
        f"{RESULTS}/models/motion/motion_cvae.pt",
        f"{RESULTS}/models/motion/recognition.pt",

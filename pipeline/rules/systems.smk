# All four systems side by side on one garment.

if COMPARED:

    # Alone on the machine: it takes all cores, though each system that it times uses one.
    rule compare_systems:
        input:
            template=f"{RESULTS}/garments/{COMPARED}.npz",
            descriptor=model_file("shape_descriptor").format(garment=COMPARED),
            codes=codes_file().format(garment=COMPARED),
            repeated=f"{RESULTS}/tests/{COMPARED}/repeated.h5",
            timing=part("timing").format(garment=COMPARED),
            outfits=layer_files("garments/{layer}.npz"),
            models=compared(compared_model),
            benchmarks=compared(compared_benchmark)
            + [
                f"{RESULTS}/benchmarks/train_shape_descriptor/{COMPARED}_shape_descriptor_"
                f"{config['models']['shape_descriptor']['use']}.tsv"
            ],
            shards=[f"{RESULTS}/shards/{COMPARED}/{name}.h5" for name in shard_names(config, ("materials", "motions"))],
            code=stage_sources("compare_systems"),
        output:
            table=f"{RESULTS}/tables/systems.csv",
            figures=directory(f"{RESULTS}/figures/systems"),
        log:
            f"{RESULTS}/logs/compare_systems.log",
        benchmark:
            f"{RESULTS}/benchmarks/compare_systems.tsv"
        conda:
            ENVIRONMENT
        threads: workflow.cores
        resources:
            device=DEVICE,
        params:
            spec=systems_spec.compare_systems_spec(config),
        shell:
            "python -m pipeline.compare_systems --spec {params.spec:q} --out {output.table} {output.figures}"
            " --in {input.template} {input.descriptor} {input.codes} {input.repeated} {input.timing} {input.outfits}"
            " {input.models} {input.benchmarks} {input.shards} --device {resources.device} --threads 1 2>&1 | tee {log}"

    # It writes its table itself, nothing is left to join.
    ruleorder: compare_systems > table


rule systems:
    input:
        f"{RESULTS}/tables/systems.csv" if COMPARED else [],

# Scenes for ARCSim: a target of its own, for the program that reads them is not part of the run.


rule export_arcsim:
    input:
        template=f"{RESULTS}/garments/{{garment}}.npz",
        motions=f"{RESULTS}/motions/batch_0000.h5",
        code=stage_sources("export_arcsim"),
    output:
        scene=f"{RESULTS}/arcsim/{{garment}}/scene.json",
        material=f"{RESULTS}/arcsim/{{garment}}/material.json",
        mesh=f"{RESULTS}/arcsim/{{garment}}/garment.obj",
        mapping=f"{RESULTS}/arcsim/{{garment}}/mapping.json",
        segments=directory(f"{RESULTS}/arcsim/{{garment}}/segments"),
    log:
        f"{RESULTS}/logs/export_arcsim/{{garment}}.log",
    conda:
        ENVIRONMENT
    params:
        spec=lambda w: spec.timing_spec(config, w.garment),
    shell:
        "python -m pipeline.export_arcsim --spec {params.spec:q} --out {output.scene} --in {input.template}"
        " {input.motions} 2>&1 | tee {log}"


rule arcsim:
    input:
        expand(f"{RESULTS}/arcsim/{{garment}}/scene.json", garment=GARMENTS),

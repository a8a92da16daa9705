"""Configuration: every mistake ends in one sentence with the file, the key, what was found and what is allowed."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from pipeline.config import ConfigError, load_config

CONFIGS = Path(__file__).parent.parent / "configs"
DEFAULT = CONFIGS / "default.yaml"


def refusal(tmp_path: Path, overlay: str) -> str:
    """The sentence with which default.yaml under an overlay is refused."""
    file = tmp_path / "mine.yaml"
    file.write_text(overlay)
    with pytest.raises(ConfigError) as error:
        load_config([DEFAULT, file])
    sentence = str(error.value)
    assert "\n" not in sentence
    return sentence.replace(str(file), "mine.yaml")


@pytest.mark.parametrize("name", ["smoke.yaml", "paper.yaml", "long.yaml"])
def test_shipped_configs_are_valid(name):
    assert load_config([DEFAULT, CONFIGS / name])["run"] == name.removesuffix(".yaml")


def test_null_takes_out_what_the_default_holds(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("garments: {skirt: null}\nmodels: {mesh_vae_gan: {variants: {coma-1: null}}}")
    config, default = load_config([DEFAULT, file]), load_config([DEFAULT])
    assert set(default["garments"]) - set(config["garments"]) == {"skirt"}
    variants = [set(one["models"]["mesh_vae_gan"]["variants"]) for one in (default, config)]
    assert variants[0] - variants[1] == {"coma-1"}
    refused = refusal(tmp_path, "models: {mesh_vae_gan: {variants: {anchored: null}}}")
    assert "models.mesh_vae_gan.use: found 'anchored'; allowed are the variants that are configured" in refused


@pytest.mark.parametrize("name", ["default.yaml", "smoke.yaml", "paper.yaml", "mocap.yaml", "long.yaml"])
def test_every_value_has_its_unit(name):
    for number, line in enumerate((CONFIGS / name).read_text().splitlines(), 1):
        value = line.split("#")[0].strip()
        if value and not value.endswith(":"):
            assert "#" in line, f"{name}:{number} has no comment: {line.strip()}"
            comment = line.split("#", 1)[1]
            choice = " or " in comment or "," in comment
            assert "[" in comment or choice, f"{name}:{number} names neither a unit in brackets nor the choices"


CASES = {
    "unknown key": (
        "garments: {skirt: {lenght: 0.5}}",
        ["mine.yaml: garments.skirt.lenght: unknown key (did you mean 'length'?)", "allowed are", "length"],
    ),
    "unknown garment": (
        "garments: {skirt: {kind: kilt}}",
        [
            "mine.yaml: garments.skirt.kind: unknown garment 'kilt'; allowed are dress, jumpsuit, mesh, outfit, pants, "
            "skirt, top, tshirt"
        ],
    ),
    "a mesh without a file": (
        "garments: {coat: {kind: mesh, worn_as: dress}}",
        ["mine.yaml: garments.coat.file: the key is missing; a mesh needs file and worn_as"],
    ),
    "a mesh file that is not there": (
        "garments: {coat: {kind: mesh, worn_as: dress, file: coat.obj}}",
        ["mine.yaml: garments.coat.file: 'coat.obj' is no file"],
    ),
    "a mesh worn as something else": (
        "garments: {coat: {kind: mesh, worn_as: hat, file: coat.obj}}",
        ["mine.yaml: garments.coat.worn_as: found 'hat'; allowed are skirt, pants, tshirt, top, jumpsuit, dress"],
    ),
    "a measure of a mesh": (
        "garments: {skirt: {kind: mesh, worn_as: skirt, file: coat.obj}}",
        ["garments.skirt.ease: a mesh has no such key; allowed are file, worn_as, scale, held"],
    ),
    "no number of vertices": (
        "garments: {coat: {kind: pants}}",
        ["mine.yaml: garments.coat.vertices: the key is missing; garments of kind pants need it"],
    ),
    "a number that is none": (
        "motions: {fps: .nan}",
        ["mine.yaml: motions.fps: found nan; allowed are finite numbers"],
    ),
    "centimetres": ("garments: {skirt: {length: 55}}", ["mine.yaml: garments.skirt.length: found 55", "m"]),
    "length outside its kind": (
        "garments: {skirt: {length: 1.5}}",
        ["mine.yaml: garments.skirt.length: found 1.5; allowed are 0.15 to 1.1 m for a skirt"],
    ),
    "measure of another kind": (
        "garments: {skirt: {sleeve: 0.2}}",
        ["mine.yaml: garments.skirt.sleeve: a skirt has no such measure; allowed are length, ease, flare"],
    ),
    "a unit written out": (
        "garments: {skirt: {length: 55 cm}}",
        ["mine.yaml: garments.skirt.length: found '55 cm'; allowed is a number", " m"],
    ),
    "a number that YAML takes for text": (
        "garments: {skirt: {ranges: {bend: {min: 1e-5, max: 1.0e-3}}}}",
        ["mine.yaml: garments.skirt.ranges.bend.min: found '1e-5'; allowed is a number"],
    ),
    "min above max": (
        "garments: {skirt: {ranges: {density: {min: 0.4, max: 0.1}}}}",
        ["mine.yaml: garments.skirt.ranges.density: min 0.4 is above max 0.1; min must not be above max"],
    ),
    "negative density": (
        "garments: {skirt: {ranges: {density: {min: -0.1}}}}",
        ["mine.yaml: garments.skirt.ranges.density.min: found -0.1; allowed are 0.01 to 2 kg/m^2"],
    ),
    "unknown parameter": (
        "garments: {skirt: {base: {densty: 0.1}}}",
        ["mine.yaml: garments.skirt.base.densty: unknown parameter 'densty' (did you mean 'density'?)"],
    ),
    "unknown parameter to search": (
        "ranges: {parameters: [strech]}",
        ["mine.yaml: ranges.parameters.strech: unknown parameter 'strech' (did you mean 'stretch'?); allowed are"],
    ),
    "limits of the search outside the physical ones": (
        "ranges: {limits: {density: {min: 0.1, max: 5.0}}}",
        ["mine.yaml: ranges.limits.density.max: found 5; allowed are 0.01 to 2 kg/m^2"],
    ),
    "limits of the search beside the base": (
        "ranges: {limits: {substeps: {min: 30, max: 40}}}",
        ["mine.yaml: ranges.limits.substeps: found 30 to 40; the base value 24 of skirt must lie between"],
    ),
    "half a substep": (
        "garments: {skirt: {base: {substeps: 20.5}}}",
        ["garments.skirt.base.substeps: found 20.5; allowed are whole numbers"],
    ),
    "unknown label": (
        "motions: {procedural: {labels: [walk, fly]}}",
        ["mine.yaml: motions.procedural: unknown motion label 'fly'; known are", "walk"],
    ),
    "more labels than there are": (
        "motions: {procedural: {labels: 999}}",
        ["mine.yaml: motions.procedural: 999 labels are asked for, the generator knows"],
    ),
    "a share of pinched vertices that is none": (
        "simulation: {bounds: {pinched_vertices: 3}}",
        ["mine.yaml: simulation.bounds.pinched_vertices: found 3", "share of the vertices"],
    ),
    "a negative bound": (
        "simulation: {bounds: {crossing_pairs: -1}}",
        ["mine.yaml: simulation.bounds.crossing_pairs: found -1", "pairs a vertex"],
    ),
    "more triangles than there are": (
        "simulation: {bounds: {triangles_inside: 9}}",
        ["mine.yaml: simulation.bounds.triangles_inside: found 9", "triangles a vertex"],
    ),
    "a bound that is not there": (
        "simulation: {bounds: {pinched_frames: 3}}",
        ["mine.yaml: simulation.bounds.pinched_frames: unknown key", "pinched_vertices"],
    ),
    "no folder": ("motions: {source: bvh}", ["motions.bvh: no folder is given"]),
    "folder that is not there": (
        "motions: {source: bvh, bvh: {folder: no/such/folder}}",
        ["mine.yaml: motions.bvh", "no/such/folder"],
    ),
    "samples that do not fill their shards": (
        "data: {materials: {samples: 41}}",
        ["mine.yaml: data.materials.samples: found 41; allowed are multiples of samples_per_shard = "],
    ),
    "too many clips": ("data: {materials: {clips: 9999}}", ["data.materials.clips: found 9999; the motions give"]),
    "nothing held out": (
        "data: {splits: {parameters_every: 900}}",
        ["data.materials.samples", "or no set is held out"],
    ),
    "fewer than no body": (
        "data: {bodies: {samples: -1}}",
        ["mine.yaml: data.bodies.samples: found -1; allowed is a whole number from 0 to 10000 body shapes"],
    ),
    "too few bodies": (
        "data: {bodies: {samples: 3, samples_per_shard: 1}}",
        ["data.bodies.samples: found 3; at least bodies_every = 4, or no body is held out, or 0 for no such data"],
    ),
    "bodies that do not fill their shards": (
        "data: {bodies: {samples: 6}}",
        ["mine.yaml: data.bodies.samples: found 6; allowed are multiples of samples_per_shard = 4"],
    ),
    "bodies that are none": (
        "data: {bodies: {spread: 5}}",
        ["mine.yaml: data.bodies.spread: found 5; allowed is", "1.5 standard deviations"],
    ),
    "bodies on more clips than there are": (
        "data: {bodies: {clips: 9999}}",
        ["data.bodies.clips: found 9999; the motions give"],
    ),
    "heads": (
        "models: {motion_cvae: {variants: {actor: {heads: 3}}}}",
        ["mine.yaml: models.motion_cvae.variants.actor.heads: found 3; allowed are divisors of width"],
    ),
    "variant that is not there": (
        "models: {shape_descriptor: {use: best}}",
        ["mine.yaml: models.shape_descriptor.use: found 'best'; allowed are paper, residual-pca"],
    ),
    "seeds of a variant that is not there": (
        "models: {motion_cvae: {seeds: {best: 3}}}",
        ["models.motion_cvae.seeds.best: no such variant; allowed are the variants that are configured: paper, dense"],
    ),
    "no seed": (
        "models: {motion_cvae: {seeds: {dense: 0}}}",
        ["mine.yaml: models.motion_cvae.seeds.dense: found 0; allowed is a whole number from 1 to 100 trainings"],
    ),
    "a name that is kept for seeds": (
        "models: {motion_invariant: {variants: {mine-seed-2: {kind: pooled}}}}",
        ["mine.yaml: models.motion_invariant.variants"],
    ),
    "like a variant that is not there": (
        "models: {motion_invariant: {variants: {mine: {like: poled}}}}",
        ["mine.yaml: models.motion_invariant.variants.mine.like: found 'poled'; allowed are pooled, paper"],
    ),
    "like a variant that is like another": (
        "models: {motion_invariant: {variants: {a: {like: pooled}, b: {like: a}}}}",
        ["mine.yaml: models.motion_invariant.variants.b.like: found 'a'; allowed are pooled, paper"],
    ),
    "neither a whole variant nor like one": (
        "models: {motion_invariant: {variants: {mine: {kind: pooled, training: {epochs: 3}}}}}",
        ["mine.yaml: models.motion_invariant.variants.mine.latent: the key is missing; needed are latent, width"],
    ),
    "a code longer than the components": (
        "models: {shape_descriptor: {curve: {codes: [25, 900]}}}",
        ["mine.yaml: models.shape_descriptor.curve.codes.1: found 900; allowed are up to its components = 768"],
    ),
    "a code of nothing": (
        "models: {shape_descriptor: {curve: {codes: [0]}}}",
        ["mine.yaml: models.shape_descriptor.curve.codes.0: found 0"],
    ),
    "device": ("compute: {device: tpu}", ["mine.yaml: compute.device: found 'tpu'; allowed are auto, cpu, cuda"]),
    "duplicate key": ("run: a\nrun: b", ["mine.yaml: line 2: key 'run' stands twice"]),
    "no YAML": ("run: [", ["mine.yaml, line"]),
    "no mapping": ("- a\n- b", ["mine.yaml: holds list"]),
}


@pytest.mark.parametrize("case", CASES)
def test_a_mistake_gets_one_sentence(tmp_path, case):
    overlay, parts = CASES[case]
    sentence = refusal(tmp_path, overlay)
    for part in parts:
        assert part in sentence, sentence


def test_a_missing_key_is_named(tmp_path):
    config = yaml.safe_load(DEFAULT.read_text())
    del config["motions"]["fps"]
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump(config))
    with pytest.raises(ConfigError, match=r"motions\.fps: the key is missing; needed are"):
        load_config([file])


def test_a_file_that_is_not_there_is_named():
    with pytest.raises(ConfigError, match=r"nowhere\.yaml: cannot be read"):
        load_config(["nowhere.yaml"])

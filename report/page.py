"""The page of a run: one HTML file that holds everything it shows.

In: the folder of a run and its configuration. Out: HTML text. Pictures are data URIs, charts are inline SVG, style and
the few lines of script stand in the page: it opens without a network, from a mail as from a disk. Texts of the run are
escaped by the template.
"""

from __future__ import annotations

import base64
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from evaluation.table import Row
from report.captions import CAPTIONS
from report.columns import readable_seconds, significant
from report.flow import flow_diagram
from report.machine import machine_facts, source_version
from report.run_files import MEDIA_TYPES, Picture, RunFiles
from report.sections import all_sections
from report.sections.blocks import Run
from report.tables import is_reference, table_view

HERE = Path(__file__).parent


def build_page(folder: str | Path, config: Mapping[str, Any], plan: Mapping[str, int] | None = None) -> str:
    """The page of a run.

    Args:
        folder: ``results/<run>``; what is missing in it is named on the page.
        config: Configuration of the run, printed as it is.
        plan: Planned ``clips`` and ``labels``, for the data-flow diagram.

    Returns:
        A complete HTML document.
    """
    files = RunFiles(folder)
    run = str(config.get("run", files.folder.name))
    environment = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["inline"] = data_uri
    environment.filters["svg"] = Markup
    stages = files.stages()
    whole = Run(files, config)
    return environment.get_template("template.html").render(
        run=run,
        sentence=sentence(config),
        hero=hero_pictures(whole.found),
        headlines=headlines(files),
        flow=flow_diagram(flow_counts(files, config, plan or {})),
        stages=table_view(stages, mark=False, keys=()) if stages else None,
        stages_caption=CAPTIONS["stages"],
        stages_total=readable_seconds(sum(float(r["total_s"]) for r in stages)) if stages else "",
        sections=all_sections(whole),
        config_text=yaml.safe_dump(_plain(config), sort_keys=False, allow_unicode=True, width=110),
        machine=machine_facts(),
        source=source_version(),
        commands=commands(run),
        date=time.strftime("%-d %B %Y", time.gmtime(files.newest())) if files.newest() else "",
        style=Markup((HERE / "style.css").read_text(encoding="utf-8")),
    )


def sentence(config: Mapping[str, Any]) -> str:
    """What the run is, in one sentence."""
    garments = list(config.get("garments", {}))
    bodies = {"full": "6,890", "small": "1,229"}
    body = bodies.get(config.get("body", {}).get("resolution", ""), "")
    what = " and ".join([", ".join(garments[:-1]), garments[-1]] if len(garments) > 1 else garments) or "Garments"
    on = f" on a body of {body} vertices" if body else ""
    return (
        f"{what[:1].upper()}{what[1:]}{on}: simulated under sampled materials and motions, learned by four networks, "
        "and held against what needs no network."
    )


def hero_pictures(pictures: list[Picture]) -> list[Picture]:
    """A simulated and a generated animation, of different garments where there are two; stills where there is none."""
    simulated = [p for p in pictures if p.kind == "simulated"]
    generated = [p for p in pictures if p.kind == "generated"]
    if not simulated and not generated:
        return [p for p in pictures if p.kind == "hero"][:2]
    first = simulated[:1]
    other = [p for p in generated if not first or p.garment != first[0].garment] or generated
    return first + other[:1]


def headlines(files: RunFiles) -> list[tuple[str, str]]:
    """The few (figure, what it is) pairs that a reader wants first; of missing tables there are none."""
    found: list[tuple[str, str]] = []
    simulated = files.table("simulation")
    frames = sum(int(r.get("frames") or 0) for r in simulated)
    if frames:
        dropped = sum(int(r.get("dropped") or 0) for r in simulated)
        sequences = sum(int(r.get("sequences") or 0) for r in simulated)
        found.append((_thousands(frames), f"frames simulated in {_thousands(sequences)} sequences, {dropped} dropped"))
    rows = [r for r in files.table("garment_regressor") if not is_reference(r) and r.get("rmse_mm") is not None]
    rows = [r for r in rows if r.get("split", "unseen_motions") == "unseen_motions"]
    for garment in dict.fromkeys(r["garment"] for r in rows):
        learned = [float(r["rmse_mm"]) for r in rows if r["garment"] == garment and _is_network(r)]
        plain = [float(r["rmse_mm"]) for r in rows if r["garment"] == garment and not _is_network(r)]
        if learned and plain:
            text = f"RMSE of the best {garment} network on unseen motions; best without one: {min(plain):.1f}\u00a0mm"
            found.append((f"{min(learned):.1f} mm", text))
    speed_ups = [
        (float(r["speed_up_over_implicit"]), r)
        for r in files.table("timing")
        if r.get("solver") == "garment regressor" and r.get("speed_up_over_implicit")
    ]
    if speed_ups:
        most, row = max(speed_ups, key=lambda pair: pair[0])
        found.append(
            (f"{significant(most, 2)} ×", f"faster than implicit Euler: the {row['garment']} regressor, one thread")
        )
    return found


def flow_counts(files: RunFiles, config: Mapping[str, Any], plan: Mapping[str, int]) -> dict[str, str]:
    """The line below each station of the data-flow diagram."""
    rows = files.table("simulation")
    garments = config.get("garments", {})
    sampled = config.get("data", {}).get("materials", {}).get("samples")
    sequences = sum(int(r.get("sequences") or 0) for r in rows)
    frames = sum(int(r.get("frames") or 0) for r in rows)
    dropped = sum(int(r.get("dropped") or 0) for r in rows)
    shards = files.shard_files()
    models = config.get("models", {})

    def variants(name: str) -> str:
        count = len(models.get(name, {}).get("variants", {}))
        return f"{count} variants" if count > 1 else ""

    counts = {
        "parameters": f"{sampled} a garment + base" if sampled is not None else "",
        "garments": ", ".join(garments) if len(garments) < 3 else f"{len(garments)} garments",
        "motions": f"{plan['clips']} clips, {plan['labels']} labels" if plan else "",
        "simulation": f"{sequences} kept, {dropped} dropped" if rows else "",
        "shards": f"{len(shards)} files, {_thousands(frames)} frames" if shards else f"{_thousands(frames)} frames",
        "shape_descriptor": variants("shape_descriptor"),
        "motion_invariant": variants("motion_invariant"),
        "garment_regressor": variants("garment_regressor"),
        "motion_cvae": variants("motion_cvae") or "from labels",
        "collision_tuning": "on generated motions",
        "animation": "refined, never simulated",
    }
    return {name: text for name, text in counts.items() if text}


def commands(run: str) -> list[tuple[str, str]]:
    """(what, command) pairs that make this run again from a checkout."""
    overlay = f" --configfile configs/{run}.yaml" if run != "default" and (HERE.parent / f"configs/{run}.yaml").exists() else ""  # fmt: skip  # noqa: E501
    make = {"default": "make all", "smoke": "make smoke"}.get(run)
    steps = [("Environment and run", make)] if make else []
    return [
        *steps,
        ("The workflow itself", f"snakemake all{overlay} --cores 2"),
        ("Only its tables", f"snakemake tables{overlay} --cores 2"),
        ("Tests", "make test"),
    ]


def _is_network(row: Row) -> bool:
    return str(row.get("method", "")).startswith("regressor")


def _thousands(number: int) -> str:
    return f"{number:,}".replace(",", "\u202f")


def data_uri(file: Path) -> str:
    """A file of a type that the page shows, as an address that holds it."""
    return f"data:{MEDIA_TYPES[file.suffix]};base64,{base64.b64encode(file.read_bytes()).decode('ascii')}"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value

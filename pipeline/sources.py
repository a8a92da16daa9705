"""Which of the project's files a stage is made of: what it imports, directly or not, and the data they read.

Snakemake sees that a stage's own file changed, not that a module it imports did. So every rule declares the stage's
sources as inputs; they are found by reading the import statements, without running anything, so that no list has to be
kept by hand.
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

DATA = {
    "body/model.py": ("body/data/*.npz",),
    "report/page.py": ("report/*.html", "report/*.css"),
}
"""Files that a module reads beside the ones it is given."""


def stage_sources(stage: str) -> list[str]:
    """Paths, relative to the project, of ``pipeline/<stage>.py`` and of all it stands on; sorted."""
    found: set[str] = set()
    waiting = [f"pipeline/{stage}.py"]
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.add(path)
        waiting += _imported(ROOT / path)
    data = {str(p.relative_to(ROOT)) for path in found for pattern in DATA.get(path, ()) for p in ROOT.glob(pattern)}
    return sorted(found | data)


@cache  # most stages stand on the same files, and reading one takes longer than all else that is done with it
def _imported(path: Path) -> tuple[str, ...]:
    """The project's own files that a module imports."""
    found: dict[str, None] = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            # ``from models import pca`` names a module, ``from models.pca import Pca`` something inside one.
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        found.update((file, None) for name in names for file in _files_of(name))
    return tuple(found)


@cache
def _files_of(name: str) -> tuple[str, ...]:
    """The module's file, and the ``__init__`` of every package on the way to it."""
    parts = name.split(".")
    bases = [ROOT.joinpath(*parts[:depth]) for depth in range(1, len(parts) + 1)]
    candidates = [file for base in bases for file in (base.with_suffix(".py"), base / "__init__.py")]
    return tuple(str(file.relative_to(ROOT)) for file in candidates if file.is_file())

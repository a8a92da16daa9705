"""Where an export goes: whole or not at all, and never over what is there unless that is asked for."""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from datasets.atomic import atomic_path


def refuse_existing(path: str | os.PathLike, force: bool, folder: bool = False, suffixes: Collection[str] = ()) -> None:
    """Raise ``ValueError`` where writing ``path`` would lose something.

    Args:
        path: File or folder that will be written.
        force: Whether an earlier export may be replaced.
        folder: Whether it is a folder.
        suffixes: Endings of the files of such a folder; one that holds anything else is kept even so.
    """
    path = Path(path)
    if not os.path.lexists(path):
        return
    if path.is_dir() != folder:
        raise ValueError(f"{path} is a {'file' if folder else 'folder'}; it is kept, choose another name")
    if not force:
        raise ValueError(f"{path} exists and is kept; --force replaces it")
    if folder:
        other = next((e.name for e in sorted(path.iterdir()) if e.is_dir() or e.suffix not in suffixes), None)
        if other is not None:
            raise ValueError(f"{path} holds {other}, which is no part of an export; it is kept, choose another name")


@contextmanager
def new_file(path: str | os.PathLike, force: bool = False) -> Iterator[Path]:
    """Yield a temporary path that becomes ``path`` when the block ends well.

    Raises:
        ValueError: ``path`` exists and ``force`` is not given.
        OSError: It could not be written, for example for a full disk; nothing is left behind.
    """
    final = Path(path)
    refuse_existing(final, force)
    with _plain_errors(final), atomic_path(final) as temporary:
        yield temporary


def write_bytes(path: str | os.PathLike, content: bytes | memoryview, force: bool = False) -> None:
    """Write a file of known content; errors as those of :func:`new_file`."""
    with new_file(path, force) as temporary:
        temporary.write_bytes(content)


@contextmanager
def new_folder(path: str | os.PathLike, force: bool, suffixes: Collection[str]) -> Iterator[Path]:
    """Yield a temporary folder that becomes ``path`` when the block ends well; errors as those of :func:`new_file`.

    Args:
        path: The folder.
        force: Whether an earlier export may be replaced.
        suffixes: Endings of the files that it will hold.
    """
    final = Path(path)
    refuse_existing(final, force, folder=True, suffixes=suffixes)
    temporary, old = (final.with_name(f".{final.name}.{os.getpid()}.{end}") for end in ("tmp", "old"))
    with _plain_errors(final):
        try:
            temporary.mkdir(parents=True)
            yield temporary
            if final.is_dir():
                os.replace(final, old)
            try:
                os.replace(temporary, final)
            except OSError:
                if old.is_dir():
                    os.replace(old, final)
                raise
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


@contextmanager
def _plain_errors(final: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise OSError(f"{final} could not be written ({reason}); nothing of it was left behind") from error

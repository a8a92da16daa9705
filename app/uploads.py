"""Files that come from the browser: judged by size, put on disk under a harmless name, and read by our own readers."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import TypeVar

LARGEST = 64 * 2**20
"""Bytes of an upload, at most."""

T = TypeVar("T")


def read_upload(name: str, content: bytes, read: Callable[[Path], T]) -> T:
    """What a reader makes of an uploaded file, which is gone afterwards.

    Args:
        name: As the browser calls it; only its last part and harmless letters of it are used.
        content: The bytes.
        read: A reader of files, such as ``formats.motion_file.read_motion``.

    Raises:
        ValueError: Empty or too large, or what the reader says; one sentence that names the upload and no folder.
    """
    shown = harmless(name)
    if not content:
        raise ValueError(f"{shown}: the file is empty")
    if len(content) > LARGEST:
        raise ValueError(f"{shown}: {len(content) / 2**20:.0f} MiB, at most {LARGEST // 2**20} MiB are taken")
    with tempfile.TemporaryDirectory(prefix="drapeline_") as folder:
        path = Path(folder) / shown
        path.write_bytes(content)
        try:
            return read(path)
        except (ValueError, OSError) as error:
            raise ValueError(str(error).replace(f"{folder}/", "")) from None


def harmless(name: str) -> str:
    """A file name without folders, hidden files or odd characters."""
    last = PurePosixPath(name.replace("\\", "/")).name
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", last).lstrip(".")
    stem, dot, ending = plain.rpartition(".")
    return f"{stem[:80]}.{ending[:10]}" if dot and stem else plain[:80] or "upload"

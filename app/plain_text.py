"""Texts from outside, such as names of files, among Markdown."""

from __future__ import annotations


def plain(text: str) -> str:
    """A text without what Markdown would make of it."""
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]()<>#+!|~" else letter for letter in text)

"""Hashes of content."""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import sha256


def content_hash(parts: Iterable[bytes]) -> str:
    """Hexadecimal SHA-256 of a list of byte strings; lengths count too, so that no two lists agree by chance."""
    digest = sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()

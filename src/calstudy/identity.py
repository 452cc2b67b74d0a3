"""Identity by content: the SHA-256 of canonical JSON."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any


def content_hash(content: Mapping[str, Any]) -> str:
    """Hexadecimal SHA-256 of a mapping of strings, numbers, lists and mappings.

    Numbers must already have their declared type: 1 and 1.0 are different content.
    """
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()

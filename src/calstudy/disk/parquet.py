"""Parquet files that may be damaged, or a stranger's: checksums are verified, and lines counted first."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

MOST_LINES = 50_000_000
"""Lines of a file: one of a few kilobytes may hold a billion equal ones."""


@contextmanager
def open_parquet(source: Path | bytes) -> Iterator[pq.ParquetFile]:
    """A file, or its content, to be read while the block runs.

    FileNotFoundError, NotADirectoryError: it is not there. ValueError, in one line: it is damaged, or has
    more than MOST_LINES lines.
    """
    try:
        # For a hundred small files this takes half the time of pq.read_table.
        whole = io.BytesIO(source) if isinstance(source, bytes) else source
        with pq.ParquetFile(whole, page_checksum_verification=True) as file:
            if file.metadata.num_rows > MOST_LINES:
                raise ValueError(f"it has more than {MOST_LINES / 1e6:g} million lines")
            yield file
    except (FileNotFoundError, NotADirectoryError):
        raise
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        raise ValueError((str(error).splitlines() or [type(error).__name__])[0][:80]) from error

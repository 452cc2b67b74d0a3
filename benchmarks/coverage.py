"""Print how often each 95 % interval of the tables and the ledger holds the median over the replicates.

    python benchmarks/coverage.py reports/emulated/soft-ring
    python benchmarks/coverage.py DIRECTORY        (where ``calstudy analyse`` wrote replicates.parquet)

The shipped one was made by ``calstudy plan run --engine emulator --fidelity soft --replicates 100 --study
studies/soft-ring`` and ``calstudy analyse studies/soft-ring --only coverage --format csv --out DIRECTORY``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from calstudy.analysis.replicates.coverage import coverage
from calstudy.report.replicated import read_entries


def main() -> None:
    """Read and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("directory", type=Path)
    table = coverage(read_entries(parser.parse_args().directory))
    print(table.round(4).to_string(index=False))
    worst = table.loc[table["coverage"].idxmin()]
    print(f"worst: {worst['where']}, {worst['entry']}: {worst['coverage']:.2f}")


if __name__ == "__main__":
    main()

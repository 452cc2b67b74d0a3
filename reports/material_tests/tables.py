"""Noise tables of the material tests: what runs that differ in their seed alone scatter by.

    python reports/material_tests/tables.py NAME

reads reports/material_tests/NAME/FIDELITY/runs.parquet, made by calstudy sweep, prints the table of NOTES.md
and writes the model's noise.csv.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

from calstudy.models.find import NOISE_FILE, SHIPPED
from calstudy.models.folder import load_folder
from calstudy.records import Outcome

HERE = Path(__file__).parent


def noise(name: str) -> pd.DataFrame:
    """A line for each fidelity and label: number of runs, mean and standard deviation of each response."""
    lines = []
    for path in sorted((HERE / name).glob("*/runs.parquet")):
        fidelity = path.parent.name
        model = load_folder(SHIPPED / name, fidelity=fidelity)
        runs = pd.read_parquet(path)
        if set(runs["model_hash"]) != {model.hash}:
            raise SystemExit(f"{path} is of another version of {name}; run its design again")
        for label, of in runs.groupby("label", sort=False):
            good = of[of["outcome"] == Outcome.OK]
            line = {"fidelity": fidelity, "label": label, "model_hash": model.hash}
            line |= {key: good[key].iloc[0] for key in model.parameters}
            line |= {"n": len(good), "failed": len(of) - len(good)}
            for response in model.responses:
                line[response.name] = good[response.name].mean()
                line[f"{response.name}_sd"] = good[response.name].std(ddof=1)
            lines.append(line | {"cpu_time": of["cpu_time"].mean()})
    return pd.DataFrame(lines)


def main(name: str) -> None:
    """Write noise.csv and print the table."""
    table = noise(name)
    table.to_csv(SHIPPED / name / NOISE_FILE, index=False, float_format="%.6g", lineterminator="\n")
    responses = [c.removesuffix("_sd") for c in table if c.endswith("_sd")]
    print(f"| | {' | '.join(f'`{r}`' for r in responses)} | runs | processor time, s |")
    print("|---" * (len(responses) + 3) + "|")
    for _, line in table.iterrows():
        cells = [f"{line[r]:.4g} ± {line[f'{r}_sd']:.2g}" for r in responses]
        print(f"| `{line['fidelity']}` | {' | '.join(cells)} | {line['n']} | {line['cpu_time']:.1f} |")


if __name__ == "__main__":
    main(sys.argv[1])

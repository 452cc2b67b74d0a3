"""A study with replicates that were made up: random optima of all rows, and responses in closed form."""

import numpy as np
import pandas as pd

from calstudy.plan import PARAMETERS
from calstudy.study.directory.store import write_table
from calstudy.study.reading import read_study
from calstudy.study.schema import schema_of
from closed_form import resettle, responses, run_study
from shipped_model import REPLICATED as FILES

COUNT = 3
ENGINE = "emulator 0123456789ab"


def made_up(study, number):
    """Tables of a replicate whose optima are random: correlated ones of both models, and their responses."""
    rng = np.random.default_rng(number)
    common = study.settings.provenance | {"replicate": number, "seed": study.settings.seed + number}
    lines, runs = [], []
    for row in study.plan.rows:
        line = {**common, "row": row.run, "WRL": row.WRL, "SPP": row.SPP, "outcome": "ok", "reason": ""}
        for p in study.plan.parameters:
            free = p.name in row.calibrated
            line[f"calibrated_{p.name}"] = free
            u = rng.random() if free else (p.constant - p.lower) / (p.upper - p.lower)
            v = np.clip(u + 0.1 * rng.standard_normal(), 0, 1) if free else u
            line[f"kriging_{p.name}"] = p.lower + u * (p.upper - p.lower)
            line[f"dem_{p.name}"] = p.lower + v * (p.upper - p.lower)
        for model in ("kriging", "dem"):
            found = responses({p: line[f"{model}_{p}"] for p in PARAMETERS})
            noise = 1.0 + 0.02 * rng.standard_normal(len(found))
            for (name, value), factor in zip(found.items(), noise, strict=True):
                line[f"{model}_{name}"] = value * (1.0 if name.startswith("rayleigh") else factor)
            line[f"{model}_stop"] = "improvement"
        line["runs_optimisation"] = int(rng.integers(10, 50))
        line["runs_total"] = line["runs_optimisation"] + row.samples
        lines.append(line)
        parameters = {p: line[f"dem_{p}"] for p in PARAMETERS}
        for k in range(8):
            near = {name: value * (1 + 1e-4 * k) for name, value in parameters.items()}
            phase = "sampling" if k < 4 else "jacobian"
            run = {"row": row.run, "phase": phase, "index": k, "outcome": "ok"}
            runs.append({**common, **run, **near, **responses(near)})
    return {"replicates": pd.DataFrame(lines), "replicate_runs": pd.DataFrame(runs)}


def study_with(directory, plan, change=lambda tables, number: None):
    """A study of one row with made-up replicates; its first replicate has a constant MU_PW."""
    run_study(directory, (1,), plan=plan)
    resettle(directory, engine=ENGINE)
    study = read_study(directory)
    for number in range(1, COUNT + 1):
        tables = made_up(study, number)
        if number == 1:
            tables["replicates"][["kriging_MU_PW", "dem_MU_PW"]] = 0.2
        change(tables, number)
        for name, columns in FILES.items():
            (directory / name).mkdir(exist_ok=True)
            path = directory / name / f"r-{number:03d}.parquet"
            write_table(path, tables[name], schema_of(columns, name))
    return directory

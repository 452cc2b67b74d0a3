"""The material card: what was calibrated, in which tests, with what result, and where it is valid.

A JSON file with a schema of its own version, and a hash of its content that is verified on reading. Its keys
are documented in docs/reference/material-card.md.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calstudy import __version__
from calstudy.calibration.solutions import nearness
from calstudy.disk.files import cannot_write, content_hash, write_atomically
from calstudy.errors import InputError
from calstudy.models.material.validity import validity_of
from calstudy.report.card.holdout import held_out
from calstudy.report.curves import singly_targeted
from calstudy.study.reading import Result
from calstudy.tomlfile import read_toml
from calstudy.written import text_of

SCHEMA = "calstudy-material/1"
FILE = "material.json"
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
SAMPLES = 200
"""Parameter sets of the thinned sample."""
BULK_DENSITY, PACKED = "bulk_density", 0.6
"""Response that gives the weight of a filling; its share of DENS where it was not measured."""
KEYS = (
    "schema",
    "id",
    "material",
    "calstudy",
    "target",
    "target_kind",
    "engine",
    "procedure",
    "models",
    "parameters",
    "constraints",
    "correlations",
    "sample",
    "responses",
    "holdout",
    "validity",
    "hashes",
)


@dataclass(frozen=True, slots=True)
class Card:
    """A card as it was read."""

    path: Path
    content: Mapping[str, Any]

    @property
    def optimum(self) -> dict[str, float]:
        """All parameters at the optimum, in their units."""
        return {name: float(p["optimum"]) for name, p in self.content["parameters"].items()}

    @property
    def responses(self) -> Mapping[str, Mapping[str, Any]]:
        """Targets and what was found, by response."""
        found: Mapping[str, Mapping[str, Any]] = self.content["responses"]
        return found

    @property
    def held_out(self) -> Mapping[str, Mapping[str, Any]]:
        """What was held out, and whether it passed, by response."""
        found: Mapping[str, Mapping[str, Any]] = self.content["holdout"]
        return found

    @property
    def claims(self) -> dict[str, Mapping[str, Any]]:
        """What the card says is near its target: the responses, and those held out that passed."""
        passed = {
            name: {"unit": of["unit"], "target": of["value"], "good_enough": of["tolerance"]}
            for name, of in self.held_out.items()
            if of["passed"]
        }
        return {**self.responses, **passed}


def card_of(
    result: Result, target_kind: str | None = None, material: str | None = None
) -> dict[str, Any] | None:
    """Content of the card of a calibration; None where no file names its models.

    ``target_kind`` says that the targets were ``simulated``, where only the caller knows it; ``material``
    names it, in place of the file.
    """
    path, prior = result.definition.path, result.definition.prior
    if not path.is_file():
        return None
    content = {
        "schema": SCHEMA,
        "material": material or path.stem,
        "calstudy": __version__,
        "target": result.settings.target.origin,
        "target_kind": target_kind or ("simulated" if result.settings.target.kind == "twin" else "given"),
        "engine": result.settings.engine,
        "procedure": {
            "mode": result.settings.mode,
            "seed": result.settings.seed,
            "WRL": result.definition.task.cost.WRL,
            "runs": int(result.line["runs_total"]),
            **({"prior": prior.verdict(result.line["reason"])} if prior is not None else {}),
        },
        "models": [
            section | {"hash": chosen.model.hash}
            for section, chosen in zip(read_toml(path).data["models"], result.definition.models, strict=True)
        ],
        "parameters": _parameters(result),
        "constraints": list(dict.fromkeys(result.definition.task.allowed.texts))
        if result.definition.task.allowed
        else [],
        "correlations": _correlations(result),
        "sample": _sample(result),
        "responses": _responses(result),
        "holdout": {
            held.of.response: held.of.settings
            | {
                "unit": held.of.unit,
                "mean": held.mean,
                "standard_error": held.standard_error,
                "runs": held.runs,
                "passed": held.passed,
            }
            for held in held_out(result)
        },
        "validity": {chosen.label: _validity(result, k) for k, chosen in enumerate(result.definition.models)},
        "hashes": {
            "study": result.settings.id,
            "definition": result.definition.hash,
            "file": hashlib.sha256(path.read_bytes()).hexdigest(),
        },
    }
    plain = json.loads(json.dumps(content, default=float), parse_constant=lambda _: None)
    return {"schema": SCHEMA, "id": content_hash(plain)[:16], **plain}


def write_card(result: Result, folder: Path, below: Path) -> list[Path]:
    """Write the card of a calibration into a folder ``below`` a study; returns its path, or nothing."""
    content = card_of(result)
    if content is None:
        return []
    try:
        write_atomically(folder / FILE, (json.dumps(content, indent=1) + "\n").encode(), below)
    except OSError as error:
        raise cannot_write(folder, error) from error
    return [folder / FILE]


def read_card(path: Path) -> Card:
    """Read a card; InputError where it is none, of another schema, or was changed since it was written."""
    try:
        content = json.loads(text_of(path))
    except (RecursionError, ValueError) as error:
        raise InputError(f"{path}: is not JSON ({error}); name a material.json") from error
    if not isinstance(content, dict) or "schema" not in content:
        raise InputError(f"{path}: is not a material card; calibrate writes one to STUDY/report/{FILE}")
    if content["schema"] != SCHEMA:
        raise InputError(f"{path}: has schema {content['schema']!r}, and this version reads {SCHEMA!r}")
    if missing := [key for key in KEYS if key not in content]:
        raise InputError(f"{path}: lacks {missing[0]}; write the card anew with calibrate")
    rest = {key: value for key, value in content.items() if key != "id"}
    if content_hash(rest)[:16] != content["id"]:
        raise InputError(f"{path}: was changed since it was written; write the card anew with calibrate")
    return Card(path, content)


def _parameters(result: Result) -> dict[str, Any]:
    space = result.definition.task.space
    found: dict[str, Any] = {}
    for p in space.parameters:
        entry: dict[str, Any] = {"unit": p.unit, "optimum": float(result.line[f"dem_{p.name}"])}
        if p.name in space.box.names:
            values = _drawn(result)[:, space.box.names.index(p.name)]
            entry["interval"] = [p.lower, p.upper]
            entry["quantiles"] = {f"{q:g}": float(np.quantile(values, q)) for q in QUANTILES}
            entry["left_free"] = p.name in result.free
        found[p.name] = entry
    return found


def _drawn(result: Result) -> np.ndarray:
    """Values of the solution space, drawn anew by its weights (n, d), always in the same way."""
    s, space = result.solutions, result.definition.task.space
    rng = np.random.default_rng(0)
    points = s.points[rng.choice(len(s.points), size=10 * SAMPLES, p=s.weights)]
    return np.column_stack([space.values(name, points) for name in space.box.names])


def _correlations(result: Result) -> dict[str, list[float]]:
    names = result.definition.task.space.box.names
    return dict(zip(names, result.solutions.correlations.tolist(), strict=True))


def _sample(result: Result) -> dict[str, Any]:
    names = list(result.definition.task.space.box.names)
    return {"parameters": names, "values": _drawn(result)[::10].tolist()}


def _responses(result: Result) -> dict[str, Any]:
    """Of each response with a target of its own: target, what is good enough, and what was found."""
    task = result.definition.task
    at = result.optimum_point[None]
    means, deviations = result.surrogates.predict_with_deviations(at)
    near, single = nearness(task, result.noise), singly_targeted(result)
    again, found = result.confirmed, {}
    for k, name in enumerate(task.cost.responses):
        if name not in single or name in task.cost.target.minimised:
            continue
        found[name] = {
            "unit": result.units[name],
            "target": task.cost.target.values[name],
            "target_sd": task.cost.target.sd.get(name),
            "good_enough": near[name],
            "noise": result.noise[name],
            "optimum": float(result.line[f"dem_{name}"]),
            "expected": float(means[0, k]),
            "expected_sd": float(deviations[0, k]),
            "confirmed": None
            if again is None
            else {
                "mean": float(again.mean[k]),
                "standard_error": float(again.standard_error[k]),
                "runs": again.runs,
            },
        }
    return found


def _validity(result: Result, k: int) -> dict[str, Any]:
    """Sizes, stresses and speeds of a test: the parameters were not seen at others."""
    chosen = result.definition.models[k]
    packed = PACKED * result.line.get("dem_DENS", math.nan)
    return validity_of(chosen.model, float(result.line.get(f"dem_{chosen.prefix}{BULK_DENSITY}", packed)))

"""The emulator: a model's responses as functions of its inputs, made from DEM runs and kept as data.

    DIR/emulator.json   version, what it was made from, hyperparameters
    DIR/runs.parquet    the DEM runs, with a sweep's columns

Its version is a hash of both files' content, verified whenever it is read; what it predicts follows from
them alone. Of a response that is proportional to a parameter the quotient by it is emulated: the solid
fraction of bulk density.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from calstudy import records
from calstudy.disk.files import content_hash, content_of, write_atomically
from calstudy.disk.parquet import open_parquet
from calstudy.emulator.branches import Region, off_branch
from calstudy.emulator.ensemble import Ensemble
from calstudy.emulator.process import Numbers, Observations, Offset, Overlap, Settings
from calstudy.emulator.similarity import Similarity, inputs, inputs_box, inputs_of, reduced_responses
from calstudy.engines.choose import DEFAULT
from calstudy.errors import InputError, NumericsError, SetupError, StoreError
from calstudy.models.find import EMULATOR_FILE as FILE
from calstudy.models.find import EMULATORS, SHIPPED, declaration, is_shipped
from calstudy.parameters import Array, Box, Parameter
from calstudy.records import BROKEN
from calstudy.study.directory.store import write_table
from calstudy.study.schema import schema_of, sweep_columns
from calstudy.study.sweep import RUNS
from calstudy.written import json_of

FORMAT = 2
LARGEST = 100e6
"""Bytes of an emulator's file."""
FLAT = ("rho", "delta_variance", "delta_range", "reference_noise")
"""Names under which the only offset's hyperparameters are stored."""
MARGIN = 1e-9
"""Share of an interval by which rounding may put a point outside the box."""


@dataclass(frozen=True, slots=True)
class Origin:
    """What an emulator stands for, and what its runs have in common."""

    model: str
    deck: int
    model_hash: str
    """Of the model at the reference fidelity."""
    fidelity: str
    """The reference fidelity, which is emulated."""
    cheap: str
    """The other fidelities from the cheapest, joined by commas; empty for an emulator of one fidelity."""
    variant: str
    engine: str
    """Program that ran the model."""

    @property
    def fidelities(self) -> tuple[str, ...]:
        """From the cheapest; the reference comes last."""
        return (*self.cheap.split(","), self.fidelity) if self.cheap else (self.fidelity,)

    @property
    def in_words(self) -> str:
        """The model, and its fidelity and variant where it has them."""
        return f"{self.model} ({self.variant}) at {self.fidelity} fidelity" if self.fidelity else self.model


@dataclass(frozen=True, slots=True)
class Response:
    """One emulated response."""

    name: str
    process: Ensemble
    region: Region | None
    """Where runs leave the branch that is emulated; None where they do so nowhere."""
    off: tuple[str, ...]
    """Identities of the runs that are not on the branch."""


@dataclass(frozen=True, slots=True)
class Answers:
    """What is answered for a response: both map points (m,d) of the unit cube to (m,)."""

    noise_free: Callable[[Array], Array]
    noise_sd: Callable[[Array], Array]
    """Standard deviation of a run from seed to seed."""


@dataclass(frozen=True)
class Emulator:
    """Responses at the reference fidelity as functions of the inputs (see ``similarity``)."""

    origin: Origin
    box: Box
    responses: tuple[Response, ...]
    runs: pd.DataFrame
    similarity: Similarity

    @cached_property
    def version(self) -> str:
        """Hash of all that decides a prediction."""
        values = reduced_responses(self.runs, self.similarity)
        runs = [
            [run_id, *(float(v) if np.isfinite(v) else None for v in line)]
            for run_id, line in zip(self.runs["run_id"], values, strict=True)
        ]
        return content_hash({**_content(self), "runs": runs})[:12]

    def point(self, parameters: Mapping[str, float]) -> Array:
        """Point (1,d) of the unit cube.

        InputError names an input outside the box, or a constant with another value.
        """
        for name, value in self.similarity.constants:
            if not math.isclose(parameters[name], value, rel_tol=MARGIN):
                raise InputError(
                    f"{name} is {parameters[name]:g}, but it was {value:g} in all runs of the emulator; give "
                    f"that, or run the DEM model with --engine {DEFAULT}"
                )
        values = inputs(parameters, self.similarity)
        unit = self.box.to_unit(values)
        for k, name in enumerate(self.box.names):
            if not -MARGIN <= unit[k] <= 1.0 + MARGIN:
                raise InputError(
                    f"{name} is {values[k]:g}, outside the emulator's [{self.box.lower[k]:g}; "
                    f"{self.box.upper[k]:g}]; stay inside, or run the DEM model with --engine {DEFAULT}"
                )
        return np.clip(unit, 0.0, 1.0)[None, :]

    def draw(self, number: int) -> dict[str, Answers]:
        """Responses as one draw from the posterior; equal numbers give equal functions."""
        sequences = np.random.SeedSequence(number).spawn(len(self.responses))
        return {
            response.name: Answers(*response.process.draw(np.random.default_rng(sequence)))
            for response, sequence in zip(self.responses, sequences, strict=True)
        }

    def means(self) -> dict[str, Answers]:
        """Responses as they are expected."""
        return {r.name: Answers(r.process.mean, r.process.noise_sd) for r in self.responses}


def fit_emulator(
    runs: pd.DataFrame,
    parameters: Sequence[Parameter],
    similarity: Similarity,
    reference: str | None = None,
) -> Emulator:
    """Fit to runs with a sweep's columns, of one or more fidelities of one deck.

    ``reference`` is the fidelity to emulate, by default the most expensive. Broken runs are left out. Raises
    InputError for runs that do not belong together, NumericsError where they are too few.
    """
    usable = runs[~runs["outcome"].isin(BROKEN)].reset_index(drop=True)
    origin = _origin(usable, reference)
    box = inputs_box(parameters, similarity)
    unit = box.to_unit(inputs_of(usable, similarity))
    if outside := int(((unit < -MARGIN) | (unit > 1.0 + MARGIN)).any(axis=1).sum()):
        raise InputError(f"{outside} run(s) lie outside the box of the parameters; leave them out")
    unit = np.clip(unit, 0.0, 1.0)
    points = numbered_points(unit)
    level = _level(usable, origin)
    responses = []
    for name, values in zip(similarity.reduced, reduced_responses(usable, similarity).T, strict=True):
        there = np.isfinite(values)
        overlap = _overlap(name, similarity, box) if origin.cheap else None
        try:
            data = Observations(unit[there], values[there], level[there], len(origin.fidelities), overlap)
            off_there = off_branch(data, points[there])
            process = Ensemble.fit(data.without(off_there))
            off = ~there
            off[there] = off_there
            region = Region.of(unit, off)
        except NumericsError as error:
            raise NumericsError(f"{name}: {error}") from error
        responses.append(Response(name, process, region, tuple(usable["run_id"][off])))
    return Emulator(origin, box, tuple(responses), usable, similarity)


def _level(runs: pd.DataFrame, origin: Origin) -> Numbers:
    """Place of each run's fidelity among the origin's, (n,)."""
    return np.array([origin.fidelities.index(fidelity) for fidelity in runs["fidelity"]], np.int64)


def _overlap(name: str, similarity: Similarity, box: Box) -> Overlap | None:
    """Shape of a response's offset between fidelities, where its being divided by the density tells it."""
    by_density = {
        response.reduced
        for response in similarity.responses
        if similarity.ratio and response.proportional_to == similarity.ratio[1]
    }
    return Overlap(float(box.lower[-1]), float(box.upper[-1])) if name in by_density else None


def numbered_points(unit: Array) -> Numbers:
    """Number of the point that each run (n,d) shares with others, (n,)."""
    _, numbers = np.unique(np.round(unit, 9), axis=0, return_inverse=True)
    return np.asarray(numbers, np.int64).reshape(-1)


def write_emulator(directory: Path, emulator: Emulator) -> None:
    """Write an emulator; SetupError where that cannot be done."""
    content = {"format": FORMAT, "version": emulator.version, **_content(emulator)}
    try:
        directory.mkdir(parents=True, exist_ok=True)
        write_table(
            directory / RUNS, emulator.runs, schema_of(sweep_columns(emulator.similarity.quantities), "runs")
        )
        write_atomically(directory / FILE, json.dumps(content, indent=1).encode() + b"\n")
    except OSError as error:
        raise SetupError(f"{directory}: cannot be written: {error.strerror}; choose another --out") from error


def read_emulator(directory: Path) -> Emulator:
    """Read an emulator and verify its version.

    InputError where there is none, StoreError where it is damaged or was written by another version.
    """
    path = directory / FILE
    try:
        content = json_of(content_of(path, LARGEST))
        with open_parquet(directory / RUNS) as file:
            runs = file.read().to_pandas()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError(
            f"{directory} holds no emulator; make one: calstudy emulator sample --out RUNS, "
            "then calstudy emulator fit RUNS --out DIR"
        ) from error
    except (OSError, ValueError) as error:
        raise StoreError(f"{directory}: the emulator is damaged; restore it, or fit it again") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise StoreError(f"{path}: not of this version of calstudy; fit the emulator again")
    try:
        emulator = _emulator(content, runs)
        version = emulator.version
    except (
        ArithmeticError,
        AttributeError,
        LookupError,
        NotImplementedError,
        TypeError,
        ValueError,
    ) as error:
        raise StoreError(f"{path} is damaged ({error}); restore it, or fit it again") from error
    if version != content.get("version"):
        raise StoreError(
            f"{directory}: the emulator is not what its version {content.get('version')} says; "
            "restore it, or fit it again"
        )
    return emulator


def _content(emulator: Emulator) -> dict[str, Any]:
    """What is stored of an emulator beside its runs."""
    box = emulator.box
    return _stored_similarity(emulator) | {
        "origin": asdict(emulator.origin),
        "inputs": [
            {"name": name, "lower": float(lower), "upper": float(upper)}
            for name, lower, upper in zip(box.names, box.lower, box.upper, strict=True)
        ],
        "responses": {
            response.name: {
                "settings": [_stored_settings(member.settings) for member in response.process.members],
                "centre": response.process.members[0].centre,
                "scale": response.process.members[0].scale,
                "off": list(response.off),
                "region": None if response.region is None else list(response.region.coefficients),
            }
            | ({"overlap": True} if response.process.data.overlap else {})
            for response in emulator.responses
        },
    }


def _stored_similarity(emulator: Emulator) -> dict[str, Any]:
    """The similarity as it is stored.

    Where a shipped model with fidelities declares it, it is left out: so its emulators keep their version.
    """
    if emulator.origin.fidelity and emulator.similarity == _declared(emulator.origin.model):
        return {}
    stored = asdict(emulator.similarity)
    if not emulator.similarity.constants:
        del stored["constants"]  # so that emulators from before there were any keep their version
    return {"similarity": stored}


def _declared(model: str) -> Similarity | None:
    """Similarity that a shipped model declares, where none of its parameters is constant; None of another."""
    return Similarity.of(declaration(model), ()) if is_shipped(model) else None


def _emulator(content: Mapping[str, Any], runs: pd.DataFrame) -> Emulator:
    origin = Origin(**content["origin"])
    ends = content["inputs"]
    box = Box(*(tuple(one[key] for one in ends) for key in ("name", "lower", "upper")))
    stored = content.get("similarity")
    similarity = _similarity(stored) if stored else Similarity.of(declaration(origin.model), ())
    unit = np.clip(box.to_unit(inputs_of(runs, similarity)), 0.0, 1.0)
    level = _level(runs, origin)
    responses = []
    for name, values in zip(similarity.reduced, reduced_responses(runs, similarity).T, strict=True):
        of = content["responses"][name]
        on = ~runs["run_id"].isin(of["off"]).to_numpy(bool)
        settings = [_settings(member, len(origin.fidelities)) for member in of["settings"]]
        overlap = _overlap(name, similarity, box) if of.get("overlap") else None
        data = Observations(unit[on], values[on], level[on], len(origin.fidelities), overlap)
        process = Ensemble.given(data, settings, (of["centre"], of["scale"]))
        region = None if of["region"] is None else Region(tuple(of["region"]))
        responses.append(Response(name, process, region, tuple(of["off"])))
    return Emulator(origin, box, tuple(responses), runs, similarity)


def _similarity(stored: Mapping[str, Any]) -> Similarity:
    ratio = stored["ratio"]
    return Similarity(
        tuple((name, unit) for name, unit in stored["parameters"]),
        tuple(records.Response(**response) for response in stored["responses"]),
        None if ratio is None else tuple(ratio),
        tuple((name, value) for name, value in stored.get("constants", ())),
    )


def _stored_settings(settings: Settings) -> dict[str, Any]:
    """Hyperparameters as they are stored; flat with one offset at most, which keeps versions."""
    if len(settings.offsets) > 1:
        return asdict(settings)
    offset = settings.offsets[0] if settings.offsets else Offset(1.0, 0.0, 1.0, 0.0)
    flat = dict(zip(FLAT, astuple(offset), strict=True))
    return {name: value for name, value in asdict(settings).items() if name != "offsets"} | flat


def _settings(stored: Mapping[str, Any], levels: int) -> Settings:
    own: dict[str, Any] = {name: stored[name] for name in ("variance", "noise")}
    lists: dict[str, Any] = {name: tuple(stored[name]) for name in ("ranges", "noise_slopes")}
    if "offsets" in stored:
        offsets = tuple(Offset(**offset) for offset in stored["offsets"])
    else:
        offsets = (Offset(*(stored[name] for name in FLAT)),)[: levels - 1]
    return Settings(**own, **lists, offsets=offsets)


def _origin(runs: pd.DataFrame, reference: str | None) -> Origin:
    """What runs have in common; InputError where they do not belong together."""
    if runs.empty:
        raise InputError("there is no usable run; run the design first")
    for name in ("model", "deck", "variant", "engine"):
        if len(found := sorted(map(str, runs[name].unique()))) > 1:
            raise InputError(f"the runs are of more than one {name}: {', '.join(found)}; fit them apart")
    hashes = runs.groupby("fidelity")["model_hash"].unique()
    for fidelity, of in hashes.items():
        if len(of) > 1:
            raise InputError(f"the {fidelity} runs are of two versions of the model; fit them apart")
    cost = runs.groupby("fidelity")["cpu_time"].mean().sort_values()
    chosen = str(cost.index[-1]) if reference is None else reference
    if chosen not in cost.index:
        raise InputError(f"no run has the fidelity {chosen}; there is {', '.join(cost.index)}")
    first = runs.iloc[0]
    return Origin(
        model=str(first["model"]),
        deck=int(first["deck"]),
        model_hash=str(hashes[chosen][0]),
        fidelity=chosen,
        cheap=",".join(str(name) for name in cost.index if name != chosen),
        variant=str(first["variant"]),
        engine=str(first["engine"]),
    )


def shipped_emulators(model: str) -> list[Path]:
    """Directories of the emulators that are shipped of a model, one for each fidelity and variant it has."""
    return sorted((SHIPPED / model / EMULATORS).glob("*"))


def shipped_emulator(model: str, fidelity: str, variant: str) -> Path:
    """Directory of a shipped emulator; InputError names those that there are."""
    directory = SHIPPED / model / EMULATORS / "-".join(filter(None, (fidelity, variant)))
    if not directory.is_dir():
        there = ", ".join(path.name for path in shipped_emulators(model))
        raise InputError(
            f"no emulator of {fidelity} fidelity, {variant}, is shipped ({there} are); choose with "
            "--fidelity and --variant, or name your own with --emulator DIR, made by 'calstudy emulator fit'"
        )
    return directory

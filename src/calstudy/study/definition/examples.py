"""Examples of a calibration's file: the one for glass beads, and one for chosen material tests."""

from __future__ import annotations

import csv
import io
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib import resources

from calstudy.engines.interface import Model
from calstudy.errors import InputError
from calstudy.models.angle_of_repose import DEFAULT_MODEL, shipped_model
from calstudy.models.find import FILE, model_folder
from calstudy.models.folder import FolderModel, load_folder

EXAMPLE = "glass_beads.toml"
MODELS, PARAMETERS, TARGETS = "# The DEM model. ", "# [lower, upper] calibrates", "# What was measured. "
"""How the sections of the example begin."""
POINT = "reference"
"""Label of the runs in a noise.csv whose means stand in for measurements."""
TOLERANCE = 2.0
"""Tolerance of a target, as a multiple of the noise."""
LARGEST = 0.25
"""Largest tolerance of a target, as a share of it; the targets of noisier responses are commented out."""
ABOUT_MODELS = """\
# The DEM models: each parameter set runs through all of them. A label is put before the names of a model's
# responses. [models.fixed] after a model changes what it holds fixed, such as dimensions; [models.material]
# says how your particles differ: their sizes or shape, cohesion, rolling model, walls, coarse-graining.
"""
ABOUT_TARGETS = """\
# What was measured. These are the tests' own means at a known point: put your measurements in their place,
# and remove what you did not measure. The tolerances are twice the noise of a run.
[targets]
"""


def example() -> str:
    """The commented file for glass beads that ``--init`` writes."""
    return (resources.files("calstudy.plans") / EXAMPLE).read_text()


def example_of(tests: Sequence[str]) -> str:
    """The commented file for shipped material tests that ``--init --tests`` writes.

    Its targets are the mean responses of each test at the reference point. Raises InputError for an unknown
    test, and for one that is named twice.
    """
    if not tests or len({*tests}) < len(tests):
        raise InputError(f"--tests {','.join(tests)!r}: name each test once, with commas between them")
    text = example()
    head, rest = text[: text.index(MODELS)], text[text.index(PARAMETERS) :]
    chosen = [shipped_model() if name == DEFAULT_MODEL else _measured(name) for name in tests]
    givers = Counter(response.name for model in chosen for response in model.responses)
    sections, targets = [], []
    for model in chosen:
        shares = any(givers[response.name] > 1 for response in model.responses)
        sections.append(_section(model, shares))
        targets += _targets(model, f"{model.name}_" if shares else "")
    parameters = rest[: rest.index(TARGETS)]
    return "\n".join([head + ABOUT_MODELS, *sections, parameters + ABOUT_TARGETS]) + "".join(targets)


def _measured(name: str) -> Model:
    """A shipped test at the first of its fidelities with a measured reference point, or at the first."""
    folder = model_folder(name)
    fidelities = tomllib.loads((folder / FILE).read_text()).get("fidelity", {})
    models = [load_folder(folder, fidelity=fidelity) for fidelity in fidelities] or [load_folder(folder)]
    return next((model for model in models if _means(model)), models[0])


def _section(model: Model, labelled: bool) -> str:
    fidelity = model.labels["fidelity"]
    others = ", ".join(tomllib.loads((model_folder(model.name) / FILE).read_text()).get("fidelity", {}))
    lines = ["[[models]]", f'name = "{model.name}"']
    lines += [f'label = "{model.name}"'] * labelled
    lines += [f'fidelity = "{fidelity}"    # of {others}; a run takes about {model.expected_seconds:.0f} s']
    return "\n".join([*lines, ""])


def _targets(model: Model, prefix: str) -> list[str]:
    """Lines of a model's targets; curves, and those that are too noisy to be any, are commented out."""
    means, lines = _means(model), []
    for response in model.responses:
        value, sd = (float(means.get(f"{response.name}{end}") or "nan") for end in ("", "_sd"))
        tolerance = TOLERANCE * sd
        usable = tolerance <= LARGEST * value
        line = f"{prefix}{response.name} = {{ value = {value:.4g}, tolerance = {tolerance:.2g} }}"
        lines.append(f"{'' if usable else '# '}{line}    # {response.unit}{'' if usable else '; noisy'}\n")
    for name, curve in (model.curves if isinstance(model, FolderModel) else {}).items():
        what = f"a measured curve, over {curve.abscissa}"
        lines.append(f'# {prefix}{name} = {{ curve = "{name}.csv" }}    # {curve.unit}; {what}\n')
    return lines


def _means(model: Model) -> Mapping[str, str]:
    """The line of a model's noise.csv at the reference point."""
    lines = csv.DictReader(io.StringIO(model.noise_table))
    return next((x for x in lines if (x["model_hash"], x["label"]) == (model.hash, POINT)), {})

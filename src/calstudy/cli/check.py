"""``calstudy check``: runs a material card again, and says whether it holds here."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import asdict
from typing import cast

import numpy as np
from rich.table import Table

from calstudy.cli.model import run_all
from calstudy.cli.terminal import print_json, results_console
from calstudy.engines.choose import program_of, slots
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.interface import Model
from calstudy.errors import NOT_DECIDED, NOT_HOLDING, RunError
from calstudy.parameters import Array
from calstudy.report.card import Card, Verdict, models_of, read_card, verdicts
from calstudy.report.card.check import Holds, changed, overall
from calstudy.study.definition.models import Chosen

CODES = {Holds.YES: 0, Holds.NO: NOT_HOLDING, Holds.UNDECIDED: NOT_DECIDED}


def check(a: Namespace) -> int:
    """Run the card's optimum with fresh seeds, and test its targets."""
    card = read_card(a.card)
    models = models_of(card, (*a.models, a.card.parent), a.fidelity)
    found, noise = _answers(a, card, models), {n: sd for chosen in models for n, sd in chosen.noise.items()}
    each = verdicts(card, found, noise, a.level)
    verdict, others = overall(each), changed(card, models)
    if a.json:
        print_json(
            {
                "material": card.content["material"],
                "verdict": verdict,
                "level": a.level,
                "changed": others,
                "responses": [asdict(one) for one in each],
            }
        )
        return CODES[verdict]
    out = results_console()
    out.print(_table(card, each))
    if others:
        out.print(f"Not the card's own models: {', '.join(others)}", highlight=False, soft_wrap=True)
    out.print(_words(card, each, verdict, a.level), highlight=False, soft_wrap=True, markup=False)
    return CODES[verdict]


def _answers(a: Namespace, card: Card, models: tuple[Chosen, ...]) -> dict[str, Array]:
    """Values (n,) of each response of the card, over the runs that gave it."""
    answers: dict[str, Array] = {}
    seeds = range(a.seed, a.seed + a.seeds)
    for chosen in models:
        if not set(chosen.responses) & set(card.claims):
            continue  # gives nothing but hold-outs that failed
        model = cast(Model, chosen.model)
        engine = ProgramEngine(model, program_of(model, a.liggghts), chosen.prefix)
        parameters = {name: card.optimum[name] for name in model.parameters}
        model.check(parameters)
        runs = [
            run for run in run_all(engine, parameters, seeds, a.workers or slots(model), {}) if run.usable
        ]
        if not runs:
            raise RunError(f"no run of {chosen.label} gave its responses; try it with calstudy simulate")
        for name in card.claims:
            if name in runs[0].responses:
                answers[name] = np.array([run.responses[name] for run in runs])
    return answers


def _table(card: Card, each: list[Verdict]) -> Table:
    table = Table(title=f"{card.content['material']}: {card.content['target']}", title_justify="left")
    for heading in ("", "target", "good enough", "mean here", "standard error", "unit", "p", "verdict"):
        table.add_column(heading)
    for one in each:
        numbers = (f"{v:.4g}" for v in (one.target, one.good_enough, one.mean, one.standard_error))
        held = " (held out)" if one.response in card.held_out else ""
        table.add_row(f"{one.response}{held}", *numbers, one.unit, f"{one.p:.2g}", one.verdict)
    return table


def _words(card: Card, each: list[Verdict], verdict: Holds, level: float) -> str:
    finds = " and ".join(f"{one.would_find:.2g} {one.unit} of {one.response}" for one in each)
    said = {
        Holds.YES: "The card holds here",
        Holds.NO: "The card does not hold here",
        Holds.UNDECIDED: "Whether the card holds cannot be decided by these runs: give more --seeds",
    }[verdict]
    kind = "; its targets are simulated, not measured" if card.content["target_kind"] == "simulated" else ""
    failed = ", ".join(name for name, of in card.held_out.items() if not of["passed"])
    left = f" Not tested, because they failed when the card was written: {failed}." if failed else ""
    return (
        f"{said}, tested at a level of {level:g}{kind}.{left} Beyond what is good enough the test would "
        f"find, nine times in ten, {finds}."
    )

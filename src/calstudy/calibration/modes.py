"""The two modes of the procedure: each difference between them is one setting here.

``paper`` does what the authors did and is what the 72-run study uses; ``robust`` is what we advise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calstudy.calibration.optimise import LevenbergMarquardt, SequentialQuadratic
from calstudy.calibration.sampling import maximin_optimised, maximin_search
from calstudy.calibration.surrogates import Kriging
from calstudy.errors import InputError
from calstudy.parameters import GRID, Array
from calstudy.written import choice


@dataclass(frozen=True, slots=True)
class Refinement:
    """Second optimisation of ``robust``: run the DEM model at the surrogate's optimum, refit, repeat."""

    budget: int | None = 6
    """Most DEM runs of the second optimisation."""
    tolerance: float = 0.05
    """Stop when the refitted surrogates expect less relative improvement than this of another point, ..."""
    doubt: float = 0.3
    """... and their standard deviation at the best point is below this share of a single run's noise."""
    least_move: float = 0.02
    """Stop, too, when the next point is within this share of every interval of one that failed."""


@dataclass(frozen=True, slots=True)
class Mode:
    """Settings of one mode, stored by name with every result."""

    name: str
    design: Callable[[int, int, np.random.Generator], Array]
    """Latin hypercube of (samples, parameters) in the unit cube."""
    samples: Callable[[int], int] | None
    """Samples for a number of parameters, where the task leaves them to the mode; None: it must say."""
    kriging: Kriging
    """How the responses are modelled, and where their hyperparameters are looked for."""
    one_seed: bool
    """One insertion seed for the whole study, or one for each evaluation."""
    starts: int | None
    """Starts of an optimisation on the surrogates: so many of the centre and all points run so far, those
    that the surrogates think best; None is the centre alone."""
    cautious: bool
    """Whether the surrogates' own variance counts in the sum of squares that is minimised on them."""
    second_optimisation: LevenbergMarquardt | Refinement
    first_optimisation: LevenbergMarquardt | SequentialQuadratic = field(default_factory=LevenbergMarquardt)
    grid: int | None = None
    """Steps of the `Grid` that the DEM model is run on; None, in studies from before it: at any point."""

    @property
    def takes_noise(self) -> bool:
        """Whether known noise of the responses makes a difference."""
        return self.kriging.hyperparameters == "robust"

    def knowing(self, proportional: Mapping[str, str]) -> Mode:
        """The mode for a model whose responses are proportional to parameters, as far as it knows.

        ``proportional`` has the parameter by the response's name. A mode whose Kriging models
        know no divisors stays as it is.
        """
        if self.kriging.divisors is None:
            return self
        return replace(self, kriging=replace(self.kriging, divisors=dict(proportional)))


def optimised_design(n: int, dimension: int, rng: np.random.Generator) -> Array:
    """Optimised maximin design (n,dimension) whose every coordinate is swapped some times.

    Smallest distances come within 4 % of those of a search without end: less than what differs between seeds.
    """
    return maximin_optimised(n, dimension, rng, steps=6 * n * dimension)


def few_samples(dimension: int) -> int:
    """Samples that are enough when the surrogate may shrink slopes and learns from every later run."""
    return dimension + 4


MODES: Mapping[str, Mode] = {
    "paper": Mode(
        name="paper",
        design=maximin_search,
        samples=None,
        kriging=Kriging(),
        one_seed=True,
        starts=None,
        cautious=False,
        # The paper saw 10 to 55 DEM runs (Figure 6); the budget only ends a calibration that runs away.
        second_optimisation=LevenbergMarquardt(budget=120),
    ),
    "robust": Mode(
        name="robust",
        design=optimised_design,
        samples=few_samples,
        kriging=Kriging(
            hyperparameters="robust",
            trend="constant",
            divisors={},
        ),
        one_seed=False,
        starts=2,
        cautious=True,
        first_optimisation=SequentialQuadratic(),
        second_optimisation=Refinement(),
    ),
}


def mode_of(name: str, budget: int | None = None, grid: int | None = GRID) -> Mode:
    """Mode by name, with another budget of DEM runs for the second optimisation if one is given.

    With a ``grid`` (None: without) its numerics are such that they meet it: see `on_grid`. InputError names
    the choices.
    """
    if name not in MODES:
        raise InputError(f"mode {name!r} is unknown; {choice(name, MODES)}")
    mode = MODES[name] if grid is None else on_grid(MODES[name], grid)
    if budget is None:
        return mode
    return replace(mode, second_optimisation=replace(mode.second_optimisation, budget=budget))


def on_grid(mode: Mode, steps: int) -> Mode:
    """The mode on a `Grid` of so many steps, its numerics such that last digits do not reach the next step.

    Hyperparameters are brought to rest and rounded, too. The first optimisation takes differences of a
    thousandth of each interval: on a smooth surrogate rounding outweighs what shorter ones gain.
    """
    first = mode.first_optimisation
    if isinstance(first, LevenbergMarquardt):
        first = replace(first, least_share=1e-2)
    else:
        first = replace(first, difference=1e-3, settled=True)
    return replace(mode, grid=steps, kriging=replace(mode.kriging, settled=True), first_optimisation=first)

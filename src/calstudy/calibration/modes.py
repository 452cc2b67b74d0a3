"""The two modes of the procedure. Every difference between them is a setting here.

``paper`` does what the authors did; the 72-row study uses it. ``robust`` is what we recommend.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calstudy.calibration.kriging.surrogates import Kriging
from calstudy.calibration.optimise import LevenbergMarquardt, SequentialQuadratic
from calstudy.calibration.sampling import maximin_optimised, maximin_search
from calstudy.errors import InputError
from calstudy.parameters import GRID, Array
from calstudy.written import choice


@dataclass(frozen=True, slots=True)
class Refinement:
    """Settings of the second optimisation of ``robust``: run the surrogates' optimum, refit, repeat."""

    budget: int | None = 6
    """Most DEM runs of the second optimisation."""
    expensive: int = 3
    """Most expensive ones of them where there are two fidelities; a budget that is given replaces it."""
    tolerance: float = 0.05
    """Stop when the refitted surrogates expect less than this relative improvement from another point ..."""
    doubt: float = 0.3
    """... and their standard deviation at the best point is below this share of a single run's noise."""
    most_doubt: float = 0.0
    """An optimum that k runs are going to confirm need not be known better than they will show: the doubt is
    then their standard error, 1 / sqrt(k) of the noise, if it lies between ``doubt`` and this."""
    least_move: float = 0.02
    """Also stop when the next point is within this share of every interval of a point whose run failed."""
    together: int = 1
    """Points run at once, after which the surrogates are refitted."""

    @property
    def most_expensive(self) -> int:
        """Most expensive runs of the second optimisation where there are two fidelities."""
        return self.expensive if self.budget is None else min(self.expensive, self.budget)

    def before(self, confirmation: int, spare: int) -> Refinement:
        """The settings for an optimum that so many runs are going to confirm.

        ``spare`` are the usable runs beyond the mode's ``overview``. With fewer the surrogates may take what
        a response does for noise, and doubt its mean too little. The doubt stays as it is then.
        """
        if not confirmation or spare < 0:
            return self
        return replace(self, doubt=max(self.doubt, min(self.most_doubt, confirmation**-0.5)))


def few_samples(dimension: int) -> int:
    """Number of samples of ``robust``. Few are enough: it shrinks slopes and refits to every later run."""
    return dimension + 4


@dataclass(frozen=True, slots=True)
class Mode:
    """Settings of one mode, stored by name with every result."""

    name: str
    design: Callable[[int, int, np.random.Generator], Array]
    """Latin hypercube of (samples, parameters) in the unit cube."""
    samples: Callable[[int], int] | None
    """Number of samples for a number of parameters, if the task gives none. None: the task must give it."""
    kriging: Kriging
    """How the responses are modelled and their hyperparameters are found."""
    one_seed: bool
    """Whether the whole study has one insertion seed; otherwise each DEM run has its own."""
    starts: int | None
    """Number of starts of an optimisation on the surrogates: of the centre and all points run so far, those
    where the surrogates expect the smallest cost. None: the centre alone."""
    cautious: bool
    """Whether the surrogates' variance is added to the cost that is minimised on them."""
    second_optimisation: LevenbergMarquardt | Refinement
    first_optimisation: LevenbergMarquardt | SequentialQuadratic = field(default_factory=LevenbergMarquardt)
    grid: int | None = None
    """Steps of the `Grid` on which the DEM model is run. None, in studies older than the grid: any point."""
    procedure: int = 1
    """Which of the mode's `VERSIONS` it is, counted from 1."""
    overview: Callable[[int], int] = few_samples
    """Number of runs, for a number of parameters, that show how the responses go: cheap samples are twice as
    many, checks of an earlier study at most half as many. See also `Refinement.before`."""

    @property
    def takes_noise(self) -> bool:
        """Whether the mode uses known noise of the responses."""
        return self.kriging.hyperparameters == "robust"

    def knowing(
        self,
        proportional: Mapping[str, str],
        curves: tuple[tuple[str, ...], ...] = (),
        ratios: Mapping[str, tuple[str, str]] | None = None,
    ) -> Mode:
        """The mode for what is known of the responses, by their names; a mode takes what it can use.

        ``proportional`` has the parameter that a response is proportional to, ``ratios`` two that act on it
        through their quotient alone. ``curves`` has the names of each curve's points.
        """
        kriging = replace(
            self.kriging,
            divisors=None if self.kriging.divisors is None else dict(proportional),
            ratios=None if self.kriging.ratios is None else dict(ratios or {}),
            curves=curves,
        )
        return replace(self, kriging=kriging)


def optimised_design(n: int, dimension: int, rng: np.random.Generator) -> Array:
    """Optimised MAXIMIN design (n, dimension), with six annealing steps for each coordinate.

    Its smallest distance is within 4 % of that of an unlimited search, which is less than seeds differ by.
    """
    return maximin_optimised(n, dimension, rng, steps=6 * n * dimension)


def fewer_samples(dimension: int) -> int:
    """Number of samples of ``robust`` from version 3 on: of four parameters or more 7, at least d + 1."""
    return min(few_samples(dimension), max(7, dimension + 1))


PAPER = Mode(
    name="paper",
    design=maximin_search,
    samples=None,
    kriging=Kriging(),
    one_seed=True,
    starts=None,
    cautious=False,
    # The paper saw 10 to 55 DEM runs (Figure 6); the budget only ends a calibration that runs away.
    second_optimisation=LevenbergMarquardt(budget=120),
)
ROBUST = Mode(
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
)
WITH_RATIOS = replace(ROBUST, procedure=2, kriging=replace(ROBUST.kriging, ratios={}))
VERSIONS: Mapping[str, tuple[Mode, ...]] = {
    "paper": (PAPER,),
    "robust": (
        ROBUST,
        WITH_RATIOS,
        replace(
            WITH_RATIOS,
            procedure=3,
            samples=fewer_samples,
            second_optimisation=Refinement(most_doubt=0.5),
        ),
    ),
}
"""Of each mode its versions: a study that was begun goes on with the one that it has."""
MODES: Mapping[str, Mode] = {name: versions[-1] for name, versions in VERSIONS.items()}


def mode_of(
    name: str,
    budget: int | None = None,
    grid: int | None = GRID,
    procedure: int | None = None,
    together: int = 1,
) -> Mode:
    """Mode by name, on a grid of so many steps; None: without a grid. See `on_grid`.

    ``budget`` replaces the mode's budget of DEM runs for the second optimisation; ``procedure`` chooses one
    of its `VERSIONS`, the newest by default and where it knows no such one. The second optimisation runs so
    many points ``together``. InputError: unknown name.
    """
    if name not in MODES:
        raise InputError(f"mode {name!r} is unknown; {choice(name, MODES)}")
    versions = VERSIONS[name]
    mode = versions[-1 if procedure is None else min(procedure, len(versions)) - 1]
    mode = mode if grid is None else on_grid(mode, grid)
    second = replace(mode.second_optimisation, together=together)
    if budget is not None:
        second = replace(second, budget=budget)
        if isinstance(second, Refinement):
            second = replace(second, expensive=budget)
    return replace(mode, second_optimisation=second)


def on_grid(mode: Mode, steps: int) -> Mode:
    """The mode on a `Grid` of so many steps, with numerics whose rounding errors are far below one step.

    The search for hyperparameters is brought to rest and rounded. The first optimisation takes difference
    steps of at least a hundredth (``paper``) or thousandth (``robust``) of each interval: on a smooth
    surrogate, shorter ones lose more to rounding than they gain.
    """
    first = mode.first_optimisation
    if isinstance(first, LevenbergMarquardt):
        first = replace(first, least_share=1e-2)
    else:
        first = replace(first, difference=1e-3, settled=True)
    return replace(mode, grid=steps, kriging=replace(mode.kriging, settled=True), first_optimisation=first)

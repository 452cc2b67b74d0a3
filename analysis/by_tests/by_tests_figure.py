"""What more material tests buy, drawn: recovery, solution space, and the pull of WRL, by number of tests."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from calstudy.analysis.by_tests.by_tests import QUANTITIES, by_tests, left, off, provenance, pull
from calstudy.analysis.figures.boxes import finish, sheet
from calstudy.plan import PARAMETERS
from calstudy.study.reading import Study

TITLE = "What more tests buy: distance from the truth, width left, and the pull of WRL"
# Okabe and Ito's colours, each with a marker of its own.
STYLES = dict(
    zip(
        PARAMETERS,
        (
            ("#0072B2", "o"),
            ("#D55E00", "s"),
            ("#E69F00", "D"),
            ("#009E73", "^"),
            ("#CC79A7", "v"),
            ("#000000", "P"),
        ),
        strict=True,
    )
)
ASIDE = 0.05
"""Distance of neighbouring parameters' marks along the axis."""


def by_tests_figure(study: Study) -> Figure:
    """A panel for each of three quantities; a line for each parameter, with 95 % intervals."""
    table, names = by_tests(study), {of: name for name, of, _ in QUANTITIES}
    figure, panels = sheet(3, width=3.6, height=4.2)
    tests = np.arange(1, len(study.plan.tests) + 1)
    for axes, quantity in zip(panels, (off, left, pull), strict=True):
        chosen = table[table["quantity"] == names[quantity]].set_index("parameter")
        for k, (parameter, (colour, marker)) in enumerate(STYLES.items()):
            line = chosen.loc[parameter]
            value, low, high = (
                line[[f"{end}_{k}" for k in tests]].to_numpy(float) for end in ("tests", "low", "high")
            )
            x = tests + ASIDE * (k - (len(STYLES) - 1) / 2)
            axes.plot(x, value, color=colour, marker=marker, ms=5, lw=1.2, label=parameter)
            axes.vlines(x, low, high, color=colour, lw=1)
        axes.set_xticks(tests)
        axes.set_xlabel("material tests")
        head, _, unit = names[quantity].partition(", ")
        axes.set_ylabel(f"{head},\n{unit}")
        finish(axes)
    panels[0].set_ylim(bottom=0.0)
    panels[1].set_ylim(bottom=0.0)
    panels[2].axhline(0.0, color="#6E6E6E", lw=0.8, ls="--")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=len(labels), loc="outside upper center", fontsize=8, frameon=False)
    return figure


def notes(study: Study) -> list[str]:
    """Notes under the figure."""
    return ["As in the table by_tests.", provenance(study)]

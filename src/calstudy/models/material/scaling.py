"""Coarse-graining and softening: which numbers of the engine change so that stresses stay what they are.

A coarse bead of k diameters d stands for k^3 beads in the same apparatus. Stresses must stay: a force on a
bead is stress times d^2, so every contact force grows by k^2 while the overlap stays the same share of d.

* Hertz: F = 4/3 E* sqrt(R*) overlap^1.5. With R* and overlap k times as large F grows by k^2 at the same E*:
  the stiffness stays.
* SJKR: F = CED x contact area, and the area grows by k^2: the cohesion energy density stays. Cohesion by
  surface energy (JKR) would have to be multiplied by k, for its force grows with R alone.
* Friction, rolling friction and restitution are ratios and stay. Collisions are rarer, so that this holds for
  slow, dense flow.
* The Rayleigh time-step (Eq. 1) is k times as long, and there are k^-3 as many beads: a run costs k^-4.

Softening divides YM by s. The overlap under the same load grows by s^(2/3), and so does the contact area, so
the cohesion energy density is divided by s^(2/3). Then every contact has the force that it had at s = 1 under
its overlap times s^(2/3), pull-off included.
"""

from __future__ import annotations

from calstudy.models.material.clump import Clump
from calstudy.models.material.sizes import Sizes

SOFTENED_COHESION = 2 / 3
"""Exponent by which the cohesion energy density falls with the softening."""


def cost_ratio(sizes: Sizes | Clump, costed: float) -> float:
    """What a run costs over one with beads of diameter ``costed`` (m): spheres times time-steps.

    Their mean volume gives the number of particles, their smallest sphere the time-step.
    """
    spheres = len(sizes.diameters) if isinstance(sizes, Clump) else 1
    return spheres * (costed / sizes.diameter) ** 3 * (costed / min(sizes.diameters))

"""How exactly laboratories usually measure a response, where nobody has said it.

These are assumptions: round numbers for the mean of three to five repeats by one operator. Whoever knows
better says it with ``--error``. A response without a line is not counted, and the reason stands in
`NOT_COUNTED`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Usual:
    """Standard deviation of a laboratory's value."""

    sd: float
    """In the response's unit; 0 where it is a share."""
    share: float
    """Of the value."""
    reason: str

    def at(self, value: float) -> float:
        """Standard deviation of a measured value."""
        return self.sd or self.share * abs(value)


_WEIGHED = Usual(0.0, 0.005, "a vessel filled anew and weighed: fillings differ by 1 %, their mean by half")
_SLOPE = Usual(1.0, 0.0, "slopes of repeated heaps differ by 1 to 2 deg, their mean by 1 deg")

USUAL = {
    ("angle_of_repose", "angle_of_repose_deg"): _SLOPE,
    ("angle_of_repose", "bulk_density"): _WEIGHED,
    ("uniaxial_compression", "bulk_density"): _WEIGHED,
    ("uniaxial_compression", "bulk_density_loaded"): _WEIGHED,
    ("uniaxial_compression", "loading_modulus"): Usual(0.0, 0.05, "beds filled anew differ by a tenth"),
    ("uniaxial_compression", "unloading_modulus"): Usual(0.0, 0.10, "small strains beside the frame's own"),
    ("uniaxial_compression", "largest_strain"): Usual(0.0, 0.05, "beds filled anew differ by a tenth"),
    ("draw_down", "bulk_density"): _WEIGHED,
    ("draw_down", "discharged_mass"): Usual(0.0, 0.01, "weighed; what stays differs from filling to filling"),
    ("draw_down", "discharge_rate"): Usual(0.0, 0.03, "slope of a balance's record over a second or two"),
    ("draw_down", "crater_angle_deg"): _SLOPE,
    ("draw_down", "heap_angle_deg"): _SLOPE,
    ("shear_cell", "steady_state_angle_deg"): Usual(0.5, 0.0, "a ring shear tester repeats within 1 to 2 %"),
    ("shear_cell", "yield_locus_angle_deg"): Usual(1.0, 0.0, "a straight line through few noisy peaks"),
    ("shear_cell", "wall_friction_angle_deg"): Usual(0.5, 0.0, "as the steady state, and the wall's patches"),
    ("shear_cell", "bulk_density"): _WEIGHED,
    ("rotating_drum", "slow_angle_deg"): Usual(0.7, 0.0, "mean over many avalanches of a film"),
    ("rotating_drum", "fast_angle_deg"): Usual(0.7, 0.0, "a straight line through a bent surface"),
}
"""By test and response."""
NOT_COUNTED = {
    ("uniaxial_compression", "remaining_strain"): "the difference of two small strains",
    ("draw_down", "remaining_mass"): "the filling less the discharged mass",
    ("draw_down", "discharge_time"): "discharged mass over rate",
    ("shear_cell", "peak_shear_stress"): "it is on the yield locus",
    ("shear_cell", "cohesion"): "of dry beads it is noise",
    ("rotating_drum", "slow_fluctuation_deg"): "it depends on the beads' diameter and the drum's width",
    ("rotating_drum", "fast_fluctuation_deg"): "it depends on the beads' diameter and the drum's width",
}
"""Responses that no usual error is given for, with the reason."""

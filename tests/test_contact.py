"""The deck's contacts against closed forms: each number of Tables 1 and 2 reaches the contact it belongs to.

Beads have radius R and mass m; E*, G* are the effective moduli of Hertz and Mindlin, d an overlap, f a force
over m. Rolling resistance is EPSD: a rotational spring k_r = 9/4 k_n (RF R')^2 with k_n = F_n / d, whose
torque ends at RF R' F_n, beside a dashpot of 2 eta sqrt(k_r I'); R' = R/2 and I' = 0.7 m R^2 for two beads,
R and 1.4 m R^2 at a wall. Each tolerance stands beside its reason; what was seen stays below half of it.
"""

import math
import re
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pytest import approx
from scipy.linalg import expm

from calstudy.engines.engine import ProgramEngine
from calstudy.engines.liggghts import LIGGGHTS, markers, read_dump
from calstudy.errors import RunError, SetupError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import BULK_DENSITY, REFERENCE
from calstudy.rayleigh import rayleigh_time_step
from calstudy.records import Outcome
from contact_scripts import FIXED, MODEL, PARAMETERS, TABLE_1, Bead, Bench

pytestmark = pytest.mark.liggghts

R = MODEL.particle_radius
M = MODEL.particle_mass(PARAMETERS["DENS"])
INERTIA = 0.4 * M * R**2
G = FIXED.gravity
MU_PP, MU_PW, RF_PP, RF_PW = (PARAMETERS[name] for name in ("MU_PP", "MU_PW", "RF_PP", "RF_PW"))
BEAD = PARAMETERS["YM"], FIXED.poissons_ratio
WALL = MODEL.variant.wall_youngs_modulus, MODEL.variant.wall_poissons_ratio
PRESS = 10.0
"""m/s2: force that presses a bead against another one or a wall, over its mass."""
FACETS = int(MODEL.geometry["facets"])
APOTHEM = MODEL.geometry["cylinder_diameter"] / 2 * math.sqrt(math.pi / FACETS / math.tan(math.pi / FACETS))
"""Distance of the middle of a facet from the axis: FACETS apothem^2 tan(pi / FACETS) = pi radius^2."""
NOT_ABOVE = "fix hold all setforce 0 0 NULL"
"""Nothing but the height may change, so that a bead on a bead stays there."""


def effective_modulus(one, other):
    """Hertz's E*."""
    return 1 / sum((1 - nu**2) / young for young, nu in (one, other))


def effective_shear_modulus(one, other):
    """Mindlin's G*."""
    return 1 / sum(2 * (2 - nu) * (1 + nu) / young for young, nu in (one, other))


def overlap(force, one, other, radius):
    """Hertz: F = 4/3 E* sqrt(R') d^(3/2)."""
    return (0.75 * force / effective_modulus(one, other) / math.sqrt(radius)) ** (2 / 3)


@pytest.fixture(scope="module")
def program():
    try:
        return LIGGGHTS.find()
    except SetupError as error:
        pytest.fail(f"these tests need the real LIGGGHTS: {error}", pytrace=False)


@pytest.fixture
def bench(program, tmp_path):
    return Bench(program, tmp_path)


def slope(motion, values, first, last):
    """Least-squares rate of change between two times."""
    chosen = (motion.time > first) & (motion.time < last)
    return np.polyfit(motion.time[chosen], values[chosen], 1)[0]


def facet(number, height, depth=0.0):
    """Bead at the middle of a wall's facet, pressed into it by ``depth``, and the direction outwards."""
    angle = (number + 0.5) * 2 * math.pi / FACETS
    out = np.array([math.cos(angle), math.sin(angle), 0.0])
    return Bead((*((APOTHEM - R + depth) * out)[:2].tolist(), height)), out


def pushes(directions):
    """Commands that press bead k into its direction, held at its height, without gravity.

    They come behind the walls: forces are summed up in the order of the commands.
    """
    yield "unfix gravity"
    yield "fix hold all setforce NULL NULL 0"
    for k, out in enumerate(directions, 1):
        yield f"group bead{k} id {k}"
        yield "fix push{0} bead{0} addforce {1!r} {2!r} {3!r}".format(k, *(M * PRESS * out).tolist())


def pressed_pair(bench, spins, seconds, depth=0.0, **options):
    """Two beads side by side, spinning about y, pressed together along x and held in y and z."""
    at = R - depth / 2
    beads = [Bead((s * at, 0.0, 0.1), spin=(0.0, spin, 0.0)) for s, spin in zip((-1, 1), spins, strict=True)]
    commands = list(pushes([np.array([1.0, 0, 0]), np.array([-1.0, 0, 0])]))
    commands[1] = "fix hold all setforce NULL 0 0"
    return bench.run(beads, seconds, *commands, **options)


# ---- laws: each is true of the deck's contacts, or raises AssertionError --------------------------------


def free_fall(bench):
    """z = z0 + v0 t - g t^2 / 2 exactly: velocity Verlet has no error where the force is constant."""
    seen = bench.run([Bead((0.0, 0.0, 0.2), (0.1, 0.0, 0.3))], 0.15).one(0)
    np.testing.assert_allclose(seen.z, 0.2 + 0.3 * seen.time - 0.5 * G * seen.time**2, atol=1e-10)
    np.testing.assert_allclose(seen.x, 0.1 * seen.time, atol=1e-10)
    assert seen.mass == approx(M, rel=1e-12)


def column(bench):
    """Two beads on each other on the plate, at rest: overlaps of the upper and of the lower contact."""
    seen = bench.run(
        [Bead((0.0, 0.0, R)), Bead((0.0, 0.0, 3 * R))], 0.5, bench.wall("plate"), NOT_ABOVE, frames=50
    )
    if np.abs(seen.vz[-1]).max() > 1e-9:
        raise RunError("the column did not come to rest")
    (lower, upper) = seen.z[-1]
    return 2 * R - (upper - lower), R - lower


def overlap_pp(bench):
    """The upper bead's weight. At rest nothing but Hertz is left, and rounding: (1e-16 R) / d = 1e-12."""
    assert column(bench)[0] == approx(overlap(M * G, BEAD, BEAD, R / 2), rel=1e-6)


def overlap_pw(bench):
    """The weight of both beads on the plate; tolerance as above."""
    assert column(bench)[1] == approx(overlap(2 * M * G, BEAD, WALL, R), rel=1e-6)


def restitution_pp(bench):
    """Head on without gravity. Tsuji's damping gives e at any speed.

    The contact ends within a time-step, some 1/300 of it, of where it should: 0.1 % where damping is weak.
    """
    seen = bench.run(
        [Bead((-0.006, 0.0, 0.1), (0.2, 0.0, 0.0)), Bead((0.006, 0.0, 0.1), (-0.2, 0.0, 0.0))],
        0.02,
        "unfix gravity",
    )
    assert seen.vx[-1] / 0.2 == approx(np.array([-1.0, 1.0]) * FIXED.restitution_pp, rel=1e-3)


def restitution_pw(bench):
    """Dropped from h on the plate, it comes up to e^2 h.

    The contact lasts some 0.3 ms, in which gravity takes some 3 mm/s from a bead that leaves at 313 mm/s
    and had gained about half as much before: 1 % of the height.
    """
    h = 0.020
    seen = bench.run([Bead((0.0, 0.0, R + h))], 0.1, bench.wall("plate"), frames=4000).one(0)
    rebound = seen.z[seen.time > 1.05 * math.sqrt(2 * h / G)].max() - R
    assert rebound == approx(FIXED.restitution_pw**2 * h, rel=0.01)


def restitution_of_meshes(bench):
    """Without gravity against the middle of a facet of the ring and of the cylinder.

    As p-p; but at the end of a strongly damped contact the force is still large: 0.4 %.
    """
    for number, height in ((1, R), (7, MODEL.fidelity.ring_height + 2 * R)):
        bead, out = facet(number, height, depth=-0.001)
        thrown = replace(bead, speed=tuple((0.2 * out).tolist()))
        seen = bench.run([thrown], 0.02, "unfix gravity", *bench.walls()).one(0)
        speed = seen.vx[-1] * out[0] + seen.vy[-1] * out[1]
        assert speed / 0.2 == approx(-FIXED.restitution_pw, rel=4e-3)


def friction_pp(bench):
    """Two beads that spin alike rub: spin' = -mu F R / (0.4 m R^2) = -5/2 mu f / R, and none at last.

    Nothing rolls (no relative spin), so rolling resistance is silent. The lever is R - d/2: 1e-4.
    """
    seen = pressed_pair(bench, (100.0, 100.0), 0.08)
    for k in (0, 1):
        assert slope(seen, seen.omegay[:, k], 0.02, 0.05) == approx(-2.5 * MU_PP * PRESS / R, rel=1e-3)
    assert np.abs(seen.omegay[-1]).max() < 0.01


def friction_pw(bench):
    """Slides with a = -mu g until it rolls, then at 5/7 of its speed whatever mu; lever as above."""
    v0 = 0.3
    settled = R - overlap(M * G, BEAD, WALL, R)
    seen = bench.run(
        [Bead((-0.05, 0.0, settled), (v0, 0.0, 0.0))], 0.12, bench.wall("plate"), parameters={"RF_PW": 0.0}
    ).one(0)
    until = 2 / 7 * v0 / (MU_PW * G)
    assert slope(seen, seen.vx, 0.1 * until, 0.9 * until) == approx(-MU_PW * G, rel=1e-3)
    rolling = seen.time > 1.2 * until
    assert seen.vx[rolling] == approx(5 / 7 * v0, rel=1e-3)
    assert R * seen.omegay[rolling] == approx(5 / 7 * v0, rel=1e-3)


def friction_of_the_moving_cylinder(bench):
    """A bead held against the rising cylinder is spun up by 5/2 mu f / R to the wall's own speed."""
    bead, out = facet(5, MODEL.fidelity.ring_height + 2 * R, depth=overlap(M * PRESS, BEAD, WALL, R))
    seen = bench.run(
        [bead],
        0.01,
        *bench.walls(),
        *pushes([out]),
        "fix lift all move/mesh mesh cylinder linear 0. 0. ${lift_speed}",
        parameters={"RF_PW": 0.0},
    ).one(0)
    spin = seen.omegax * out[1] - seen.omegay * out[0]
    assert slope(seen, spin, 0.0005, 0.002) == approx(2.5 * MU_PW * PRESS / R, rel=1e-3)
    assert spin[-1] * R == approx(MODEL.schedule["lift_speed"], rel=1e-3)


def rolling_friction_pp(bench):
    """Two beads that roll on each other like gears are braked by RF (R/2) F each, and come to rest:
    spin' = -RF (R/2) F / (0.4 m R^2) = -5/4 RF f / R.

    The surfaces do not slide, so friction is silent. Once the spring is at its limit the torque is exact.
    """
    seen = pressed_pair(bench, (20.0, -20.0), 0.4)
    rate = -1.25 * RF_PP * PRESS / R
    for k, sign in ((0, 1), (1, -1)):
        assert slope(seen, sign * seen.omegay[:, k], 0.05, 0.15) == approx(rate, rel=1e-4)
    assert np.abs(seen.omegay[-1]).max() < 0.01


def rolling_friction_pw(bench):
    """A rolling bead is braked by the torque RF R m g: (m R^2 + 0.4 m R^2) a / R = -RF R m g, so
    a = -5/7 RF g, and comes to rest v^2 / 2a further on.

    The lever is R - d, 1e-4; the last degrees, in which spring and dashpot act, are 1e-3 of the way.
    """
    v0, a = 0.2, 5 / 7 * RF_PW * G
    settled = R - overlap(M * G, BEAD, WALL, R)
    seen = bench.run(
        [Bead((-0.05, 0.0, settled), (v0, 0.0, 0.0), (0.0, v0 / R, 0.0))], 0.4, bench.wall("plate")
    ).one(0)
    assert slope(seen, seen.vx, 0.05, 0.25) == approx(-a, rel=1e-3)
    k = np.searchsorted(seen.time, 0.05)
    assert seen.x[-1] - seen.x[k] == approx(seen.vx[k] ** 2 / (2 * a), rel=3e-3)
    assert abs(seen.vx[-1]) < 1e-6 and abs(seen.omegay[-1]) < 1e-5


def rolling_damping_pp(bench):
    """Gears that turn within the spring's reach oscillate: 0.4 m R^2 spin' = -(k_r + c d/dt) angle, angle'
    = 2 spin, so w^2 = 2 k_r / (0.4 m R^2) = 45/16 k_n RF^2 / m and the damping ratio is
    eta sqrt(0.7 / 0.2).

    The scheme is off by (w dt)/2 = 2e-4 of the first spin; the overlap stays at rest.
    """
    force = M * PRESS
    depth = overlap(force, BEAD, BEAD, R / 2)
    w = math.sqrt(45 / 16 * force / depth / M) * RF_PP
    ratio = FIXED.rolling_viscous_damping_pp * math.sqrt(3.5)
    limit = RF_PP * R / 2 * force / (2.25 * force / depth * (RF_PP * R / 2) ** 2)
    spin = 0.1 * limit * w  # the angle reaches less than a fifth of what the spring bears
    seen = pressed_pair(bench, (spin, -spin), 10 / w, depth=depth)
    wd, t = w * math.sqrt(1 - ratio**2), seen.time
    expected = np.exp(-ratio * w * t) * (np.cos(wd * t) - ratio * w / wd * np.sin(wd * t))
    np.testing.assert_allclose(seen.omegay / spin, np.outer(expected, [1, -1]), atol=1e-3)


def rolling_damping_pw(bench):
    """A bead that rolls on the plate within the spring's reach oscillates with damping ratio eta, but for
    Mindlin's spring and dashpot in the contact's plane, through which it sits on the plate.

    So both are in the linear equations that are solved here: speed v, spin, slip s' = v - R spin, angle.
    Tolerance as p-p.
    """
    depth = overlap(M * G, BEAD, WALL, R)
    kr = 2.25 * M * G / depth * (RF_PW * R) ** 2
    c = FIXED.rolling_viscous_damping_pw * 2 * math.sqrt(1.4 * M * R**2 * kr)
    kt = 8 * effective_shear_modulus(BEAD, WALL) * math.sqrt(R * depth)
    log_e = math.log(FIXED.restitution_pw)
    ct = -2 * math.sqrt(5 / 6) * log_e / math.hypot(log_e, math.pi) * math.sqrt(kt * M)
    force = np.array([-ct, R * ct, -kt, 0.0])  # of the contact's plane, as a function of the state
    torque = -R * force - np.array([0.0, c, 0.0, kr])
    rates = np.array([force / M, torque / INERTIA, [1.0, -R, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])
    w = math.sqrt(kr / (1.4 * M * R**2))
    spin = 0.2 * depth / (2.25 * RF_PW * R) * w
    start = np.array([spin * R, spin, 0.0, 0.0])
    seen = bench.run(
        [Bead((0.0, 0.0, R - depth), (spin * R, 0.0, 0.0), (0.0, spin, 0.0))], 10 / w, bench.wall("plate")
    ).one(0)
    expected = np.array([expm(rates * t) @ start for t in seen.time])
    np.testing.assert_allclose(seen.omegay / spin, expected[:, 1] / spin, atol=1e-3)
    np.testing.assert_allclose(seen.vx / spin / R, expected[:, 0] / spin / R, atol=1e-3)


LAWS = [
    *(free_fall, overlap_pp, overlap_pw, restitution_pp, restitution_pw, restitution_of_meshes),
    *(friction_pp, friction_pw, friction_of_the_moving_cylinder, rolling_friction_pp, rolling_friction_pw),
    *(rolling_damping_pp, rolling_damping_pw),
]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_the_deck_s_contacts_obey_the_closed_form(bench, law):
    law(bench)


# ---- the laws can fail -----------------------------------------------------------------------------------

SWAPS = {
    ("restitution_pp", "restitution_pw"): (restitution_pp, restitution_pw, restitution_of_meshes),
    ("MU_PP", "MU_PW"): (friction_pp, friction_pw, friction_of_the_moving_cylinder),
    ("RF_PP", "RF_PW"): (rolling_friction_pp, rolling_friction_pw),
    ("rolling_viscous_damping_pp", "rolling_viscous_damping_pw"): (rolling_damping_pp, rolling_damping_pw),
    ("engine_youngs_modulus", "wall_youngs_modulus"): (overlap_pp, overlap_pw),
    ("poissons_ratio", "wall_poissons_ratio"): (overlap_pp, overlap_pw),
}


def swapped(text, one, other):
    """The text with two variables in each other's place."""
    names = {f"${{{one}}}": f"${{{other}}}", f"${{{other}}}": f"${{{one}}}"}
    pattern = "|".join(map(re.escape, names))
    changed = re.sub(pattern, lambda found: names[found[0]], text)
    if changed == text:
        raise RunError(f"contact.in has neither {one} nor {other}")
    return changed


@pytest.mark.parametrize(
    ("names", "law"),
    [(names, law) for names, laws in SWAPS.items() for law in laws],
    ids=lambda value: value.__name__ if callable(value) else value[0],
)
def test_a_number_at_the_other_contact_breaks_its_law(bench, names, law):
    mutant = swapped(MODEL.files["contact.in"], *names)
    with pytest.raises(AssertionError):
        law(replace(bench, contact=mutant))


def test_every_number_of_contact_in_is_swapped_once_or_is_no_pair():
    used = set(re.findall(r"\$\{(\w+)\}", MODEL.files["contact.in"]))
    alone = {"contact_model", "engine_time_step", "gravity"}
    assert used == alone | {name for names in SWAPS for name in names}


def test_the_other_epsd_breaks_the_law_of_rolling_damping(bench):
    mutant = MODEL.files["contact.in"].replace("rolling_friction epsd", "rolling_friction epsd2")
    with pytest.raises(AssertionError):
        rolling_damping_pp(replace(bench, contact=mutant))


def test_another_gravity_breaks_the_law_of_free_fall(bench):
    mutant = MODEL.files["contact.in"].replace("${gravity} vector", "9.8 vector")
    with pytest.raises(AssertionError):
        free_fall(replace(bench, contact=mutant))


def test_the_deck_has_no_contact_number_but_those_of_contact_in():
    script = MODEL.files["in.angle_of_repose"]
    lines = [line for line in script.splitlines() if not line.startswith("#")]
    assert lines.count("include contact.in") == 1
    assert not any(word in line for line in lines for word in ("property/global", "pair_style", "pair_coeff"))
    walls = [line for line in lines if "wall/gran" in line]
    assert len(walls) == 2 and all(" model ${contact_model} " in line for line in walls)
    made = [line for line in lines if "mesh/surface" in line or "primitive" in line]
    assert len(made) == 3 and all(" type 2" in line for line in made)
    templates = [line for line in lines if "particletemplate" in line]
    assert len(templates) == 1 and " atom_type 1 " in templates[0]


# ---- walls -----------------------------------------------------------------------------------------------


def test_ring_and_cylinder_push_a_bead_once_but_at_their_seam(bench):
    """A bead whose centre is within sqrt(2 R d) of the seam reaches both, and two walls of half the force
    each are dented by d / 2^(2/3); the bottom layer, at z = R, is well below the seam.
    """
    force, seam = M * PRESS, MODEL.fidelity.ring_height
    once = overlap(force, BEAD, WALL, R)
    reach = math.sqrt(2 * R * once)
    heights = [R, seam - 2 * reach, seam + 2 * reach, seam + 2 * R, seam]
    beads, directions = zip(*(facet(4 * k, z) for k, z in enumerate(heights)), strict=True)
    seen = bench.run(beads, 0.1, *bench.walls(), *pushes(directions), frames=20)
    depth = np.hypot(seen.x[-1], seen.y[-1]) + R - APOTHEM
    # The mesh is written with nine digits: 5e-11 m of an overlap of 5e-7 m.
    assert depth[:4] == approx(once, rel=2e-4)
    assert depth[4] == approx(once / 2 ** (2 / 3), rel=1e-3)


def vertices(path):
    """Corners (n, 3) of a mesh."""
    return np.array([line.split()[1:] for line in path.read_text().splitlines() if "vertex" in line], float)


# ---- the time-step ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("fidelity", ["full", "fast", "soft", "coarse", "tiny"])
def test_liggghts_own_rayleigh_time_step_is_eq_1(program, tmp_path, fidelity):
    model = load_model(TABLE_1, fidelity)
    seen = Bench(program, tmp_path, model).run(
        [Bead((0.0, 0.0, 0.1))],
        1e-3,
        "fix share all check/timestep/gran 1 1 1 warn no",
        parameters=REFERENCE,
        after=["variable share equal f_share[1]", 'print "calstudy: share ${share}"'],
        frames=2,
    )
    share = float(seen.marks["share"])
    assert share == approx(model.fidelity.time_step_share, rel=1e-12)
    simulated = rayleigh_time_step(
        REFERENCE["DENS"],
        REFERENCE["YM"] / model.fidelity.softening,
        radius=model.particle_radius,
        poissons_ratio=TABLE_1.poissons_ratio,
    )
    assert model.engine_time_step(REFERENCE) / share == approx(float(simulated), rel=1e-12)


# ---- the whole deck, watched -------------------------------------------------------------------------------


def watched(model):
    """The deck with further dumps beside its own."""
    script = model.scripts["in.angle_of_repose"]
    for frame in ("poured", "filled", "heap"):
        more = f"dump mass_{frame} all custom 1 mass_{frame}.dump id type mass radius"
        if frame == "heap":
            meshes = ("cylinder", "ring")
            more += "".join(f"\ndump {name} all mesh/stl 1 {name}_*.stl {name}" for name in meshes)
        changed = script.replace(f"dump {frame} all", f"{more}\ndump {frame} all")
        changed = changed.replace(f"undump {frame}\n", f"undump {frame}\nundump mass_{frame}\n")
        assert len(changed) > len(script) + len(more)
        script = changed
    return replace(model, scripts={**model.scripts, "in.angle_of_repose": script})


@pytest.fixture(scope="module")
def deck(program, tmp_path_factory):
    model = watched(load_model(TABLE_1, "tiny"))
    directory = tmp_path_factory.mktemp("deck") / "run"
    run = ProgramEngine(model, program).run(REFERENCE, 1, directory, threading.Event())
    if run.outcome is not Outcome.OK:
        raise RunError(run.reason)
    frames = {name: read_dump(directory / f"{name}.dump") for name in ("poured", "filled", "heap")}
    masses = {name: _table(directory / f"mass_{name}.dump") for name in frames}
    log = (directory / "log.liggghts").read_text()
    return SimpleNamespace(model=model, run=run, directory=directory, log=log, masses=masses, **frames)


THERMO = re.compile(r"^ *Step +Atoms .*\n *\d+ +(\d+) .*\n *\d+ +(\d+) ", re.MULTILINE)
"""Numbers of beads at the beginning and at the end of a run of some steps."""


def _table(path):
    rows = path.read_text().partition("ITEM: ATOMS")[2].splitlines()[1:]
    return np.array([row.split() for row in rows], float)


def test_every_bead_has_the_mass_of_its_density_and_is_of_the_beads_type(deck):
    mass = REFERENCE["DENS"] * math.pi / 6 * deck.model.fidelity.particle_diameter**3
    for name, table in deck.masses.items():
        assert len(table) == len(getattr(deck, name))
        assert set(table[:, 1]) == {1.0}
        assert table[:, 2] == approx(mass, rel=1e-5)  # written with six digits
        assert table[:, 3] == approx(deck.model.particle_radius, rel=1e-5)


def test_no_bead_is_gained_or_lost_but_those_deleted_and_each_is_counted(deck):
    inserted = [int(n) for n in re.findall(r"inserted (\d+) particle templates", deck.log)]
    deleted = [int(n) for n in re.findall(r"^Deleted (\d+) atoms", deck.log, re.MULTILINE)]
    beads = deck.run.beads
    assert sum(inserted) == beads.poured == len(deck.poured) == deck.model.fidelity.poured_beads
    assert beads.poured - deleted[0] == beads.filled == len(deck.filled)
    # A fast bead may leave the box before it is deleted; the table of the interval then ends with one less.
    raising = deck.log.index("calstudy: beads_filled")
    left_the_box = [int(a) - int(b) for a, b in THERMO.findall(deck.log, raising)]
    assert min(left_the_box) >= 0
    assert sum(deleted[1:]) + sum(left_the_box) == beads.lost == beads.filled - len(deck.heap)
    assert len(deleted) - 1 == int(markers(deck.directory / "log.liggghts")["lift_intervals"])
    poured, filled, heap = (set(frame[:, 0]) for frame in (deck.poured, deck.filled, deck.heap))
    assert heap < filled < poured and len(poured) == beads.poured
    above = deck.poured[:, 3] > deck.model.geometry["fill_height"]
    assert poured - filled == set(deck.poured[above, 0])


def test_nothing_moves_while_beads_are_removed(deck):
    stayed = np.isin(deck.poured[:, 0], deck.filled[:, 0])
    np.testing.assert_array_equal(deck.poured[stayed], deck.filled)


def test_bulk_density_is_that_of_the_spheres_cut_at_the_fill_height(deck):
    """The paper counts whole beads. Cut exactly at the plane, those above it that reach below it make up
    for the parts that stand out: over the beads on the plane, some tenth of all, the halves differ from
    each other by at most a few of 441.
    """
    r, top = deck.model.particle_radius, deck.model.geometry["fill_height"]
    out = np.clip(deck.poured[:, 3] + r - top, 0.0, 2 * r)
    below = 4 / 3 * math.pi * r**3 - math.pi * out**2 / 3 * (3 * r - out)
    volume = math.pi / 4 * deck.model.geometry["cylinder_diameter"] ** 2 * top
    cut = REFERENCE["DENS"] * below.sum() / volume
    assert deck.run.responses[BULK_DENSITY] == approx(cut, rel=0.01)
    assert deck.run.responses[BULK_DENSITY] == approx(deck.masses["filled"][:, 2].sum() / volume, rel=1e-5), (
        "the mass that LIGGGHTS gives the beads that fill the cylinder, over the volume"
    )


def test_the_cylinder_has_been_raised_as_the_script_says_and_the_ring_has_not_moved(deck):
    values = {k: float(v) for k, v in deck.model.variables(REFERENCE, 1).items()}
    step, intervals = (
        values["engine_time_step"],
        int(markers(deck.directory / "log.liggghts")["lift_intervals"]),
    )
    closed_gap = values["closed_gap_per_diameter"] * values["particle_diameter"]
    closed = math.ceil(closed_gap / values["closed_lift_speed"] / step) * values["closed_lift_speed"]
    opened = intervals * math.ceil(values["lift_interval"] / step) * values["lift_speed"]
    for name, rise in (("cylinder", (closed + opened) * step), ("ring", 0.0)):
        (path,) = deck.directory.glob(f"{name}_*.stl")
        before, after = vertices(deck.directory / f"{name}.stl"), vertices(path)
        assert len(before) == len(after) == 6 * FACETS
        low, high = (np.array([v.min(axis=0), v.max(axis=0)]) for v in (before, after))
        np.testing.assert_allclose(high - low, np.tile([0.0, 0.0, rise], (2, 1)), atol=1e-6)
    assert vertices(deck.directory / "cylinder.stl")[:, 2].min() == approx(values["ring_height"])

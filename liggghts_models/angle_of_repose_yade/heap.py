# Angle of repose and poured bulk density of spherical beads, for YADE.
#
# The same test as the LIGGGHTS deck in ../angle_of_repose: pour into a cylinder, remove what lies above the
# fill height, raise the cylinder, let the heap come to rest. parameters.json has the parameters (DENS, MU_PP,
# MU_PW, RF_PP, RF_PW, YM), the seed and what model.toml holds fixed. NOTES.md says where the codes differ.

import json
import math
import os
import random

from yade import geom, utils

# YADE makes a folder in /tmp and leaves it there; nothing here needs it.
os.rmdir(os.path.dirname(O.tmpFilename()))

with open("parameters.json") as file:
    given = json.load(file)

# ---- what is simulated (SI units) -----------------------------------------------------------------------------
CYLINDER_RADIUS, CYLINDER_TOP, FILL_HEIGHT, GRAVITY = 0.050, 0.130, 0.050, 9.81
POISSONS_RATIO, RESTITUTION_PP, RESTITUTION_PW = 0.22, 0.89, 0.6
POUR_RADIUS, POUR_BOTTOM, POUR_TOP, POUR_SPEED = 0.044, 0.070, 0.120, 0.5
POUR_TIME, POUR_INTERVAL, POUR_TRIES = 0.6, 0.03, 10_000
FACETS = 24
WALL_CONTACTS_EVERY = 10  # steps

radius = given["particle_diameter"] / 2
ring_height, plate_radius = given["ring_height"], given["plate_radius"]
mass = given["DENS"] * 4 / 3 * math.pi * radius**3
modulus = given["YM"] / given["softening"]
shear_modulus = modulus / (2 * (1 + POISSONS_RATIO))
rayleigh = math.pi * radius * math.sqrt(given["DENS"] / shear_modulus) / (0.1631 * POISSONS_RATIO + 0.8766)

# ---- rolling: EPSD's spring and limit -------------------------------------------------------------------------
# EPSD: torque at most RF F_n R*, stiffness 2.25 k_n RF^2 R*^2. Here: at most eta F_n times the mean of the two
# radii, with one constant stiffness: that of a contact that carries the weight of five beads.
effective_modulus = modulus / (2 * (1 - POISSONS_RATIO**2))


def rolling(friction, reduced):
    """Stiffness (N m/rad) and limit over the normal force (m) of a contact of this reduced radius."""
    load = 5 * mass * GRAVITY
    normal = (16 / 9 * effective_modulus**2 * reduced * load) ** (1 / 3)  # force over overlap, as EPSD has it
    return 2.25 * normal * friction**2 * reduced**2, friction * reduced


stiffness_pp, limit_pp = rolling(given["RF_PP"], radius / 2)
stiffness_pw, limit_pw = rolling(given["RF_PW"], radius)

# ---- materials, walls, contacts -------------------------------------------------------------------------------
beads = O.materials.append(FrictMat(young=modulus, poisson=POISSONS_RATIO, density=given["DENS"]))
walls = O.materials.append(FrictMat(young=modulus, poisson=POISSONS_RATIO, density=given["DENS"]))
# The polygon's area is the circle's.
polygon = CYLINDER_RADIUS * math.sqrt(2 * math.pi / (FACETS * math.sin(2 * math.pi / FACETS)))


def tube(bottom, top):
    """Ids of the facets of an open cylinder."""
    centre = (0, 0, (bottom + top) / 2)
    return O.bodies.append(
        geom.facetCylinder(centre, polygon, top - bottom, segmentsNumber=FACETS, wallMask=4, material=walls)
    )


plate = O.bodies.append(utils.wall(0, axis=2, sense=1, material=walls))
fixed = [plate, *tube(0, ring_height)]
cylinder = tube(ring_height, CYLINDER_TOP)


def pairs(of_beads, of_a_wall):
    """One value for contacts of two beads, one for those of a bead and a wall."""
    return MatchMaker(matches=((beads, beads, of_beads), (beads, walls, of_a_wall)))


def roll_on_walls():
    """Rolling on walls: YADE's own numbers are the same for all contacts, so those of walls are set here."""
    for wall in [*fixed, *cylinder]:
        for contact in O.bodies[wall].intrs():
            if contact.isReal:
                contact.phys.kr, contact.phys.maxBendPl = stiffness_pw, limit_pw


O.engines = [
    ForceResetter(),
    InsertionSortCollider(
        [Bo1_Sphere_Aabb(), Bo1_Facet_Aabb(), Bo1_Wall_Aabb()], verletDist=0.2 * radius, targetInterv=0
    ),
    InteractionLoop(
        [Ig2_Sphere_Sphere_ScGeom(), Ig2_Facet_Sphere_ScGeom(), Ig2_Wall_Sphere_ScGeom()],
        [
            Ip2_FrictMat_FrictMat_MindlinPhys(
                en=pairs(RESTITUTION_PP, RESTITUTION_PW),
                frictAngle=pairs(math.atan(given["MU_PP"]), math.atan(given["MU_PW"])),
                krot=stiffness_pp,
                eta=limit_pp / radius,
            )
        ],
        [Law2_ScGeom_MindlinPhys_Mindlin(includeMoment=True)],
    ),
    NewtonIntegrator(damping=0, gravity=(0, 0, -GRAVITY)),
    PyRunner(command="roll_on_walls()", iterPeriod=WALL_CONTACTS_EVERY),
]
O.dt = given["time_step_share"] * rayleigh


def spheres():
    """The beads."""
    return [body for body in O.bodies if isinstance(body.shape, Sphere)]


def run(seconds):
    """Simulate a while."""
    O.run(math.ceil(seconds / O.dt), True)


def energy():
    """Kinetic energy of all beads, in J."""
    return utils.kineticEnergy()


# ---- pour, until the mean speed says that the packing stands --------------------------------------------------
dice = random.Random(int(given["seed"]))
poured, wanted = 0, int(given["poured_beads"])
batches = round(POUR_TIME / POUR_INTERVAL)
for batch in range(batches):
    there = [body.state.pos for body in spheres() if body.state.pos[2] > POUR_BOTTOM - 2 * radius]
    tries = 0
    while poured < wanted * (batch + 1) / batches and tries < POUR_TRIES:
        tries += 1
        r, angle = POUR_RADIUS * math.sqrt(dice.random()), 2 * math.pi * dice.random()
        z = POUR_BOTTOM + (POUR_TOP - POUR_BOTTOM) * dice.random()
        place = Vector3(r * math.cos(angle), r * math.sin(angle), z)
        if all((place - other).squaredNorm() > (2 * radius) ** 2 for other in there):
            there.append(place)
            bead = O.bodies.append(utils.sphere(place, radius, material=beads))
            O.bodies[bead].state.vel = (0, 0, -POUR_SPEED)
            poured += 1
    run(POUR_INTERVAL)
for _ in range(80):
    run(0.025)
    if energy() < len(spheres()) * 0.5 * mass * 0.010**2:
        break
print("beads poured:", len(spheres()))

# ---- remove what lies above the fill height -------------------------------------------------------------------
for body in spheres():
    if body.state.pos[2] > FILL_HEIGHT:
        O.bodies.erase(body.id)
filled = len(spheres())
print("beads filled:", filled)
print("bulk density:", filled * mass / (math.pi * CYLINDER_RADIUS**2 * FILL_HEIGHT))


# ---- raise the cylinder until it is clear of the heap and nothing moves -----------------------------------------
# While the gap is too narrow for a bead nothing can leave; it is opened faster than the rest.
def raise_cylinder(speed):
    """Move its facets upwards at a speed in m/s."""
    for facet in cylinder:
        O.bodies[facet].state.vel = (0, 0, speed)


bottom = O.bodies[cylinder[0]].state.pos[2] - ring_height
raise_cylinder(0.050)
run(0.8 * given["particle_diameter"] / 0.050)
raise_cylinder(0.010)
calm = 0
for _interval in range(84):
    run(0.05)
    highest = max(body.state.pos[2] for body in spheres())
    is_clear = O.bodies[cylinder[0]].state.pos[2] - bottom > highest + radius
    calm = calm + 1 if is_clear and energy() < 0.5 * mass * 0.005**2 else 0
    for body in spheres():
        if math.hypot(body.state.pos[0], body.state.pos[1]) > plate_radius:
            O.bodies.erase(body.id)
    if calm >= 2:
        break

# ---- the heap, in the form of a dump of LAMMPS ------------------------------------------------------------------
heap = spheres()
with open("heap.dump", "w") as dump:
    print(f"ITEM: TIMESTEP\n{O.iter}\nITEM: NUMBER OF ATOMS\n{len(heap)}", file=dump)
    print("ITEM: BOX BOUNDS ff ff ff\n-1 1\n-1 1\n-1 1\nITEM: ATOMS id x y z radius", file=dump)
    for body in heap:
        print(body.id, *(repr(float(x)) for x in body.state.pos), repr(radius), file=dump)
print("beads heap:", len(heap))
print("lift intervals:", _interval + 1)
print("finished")

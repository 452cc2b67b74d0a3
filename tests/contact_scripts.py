"""Small LIGGGHTS scripts about one or two beads, on the shipped deck's own material section and walls.

Each script includes parameters.in, as the model writes it, and contact.in, the file that the deck includes;
plate, ring and cylinder are the deck's own lines. What holds for these scripts holds for the deck.
"""

import itertools
import re
import threading
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from calstudy.engines.liggghts import markers
from calstudy.engines.process import run_process
from calstudy.engines.program import Program
from calstudy.errors import RunError
from calstudy.models.angle_of_repose import AngleOfReposeModel, load_model
from calstudy.plan_file import load_plan

COLUMNS = ("x", "y", "z", "vx", "vy", "vz", "omegax", "omegay", "omegaz", "mass")
HEAD = """include parameters.in
atom_style granular
atom_modify map array
boundary f f f
newton off
communicate single vel yes
units si
hard_particles yes
region domain block -0.2 0.2 -0.2 0.2 -0.001 0.3 units box
create_box 2 domain
neighbor ${skin} bin
neigh_modify delay 0
include contact.in
"""
TABLE_1 = load_plan().fixed
FIXED = replace(
    TABLE_1,
    poissons_ratio=0.10,
    restitution_pp=0.9,
    restitution_pw=0.5,
    rolling_viscous_damping_pp=0.1,
    rolling_viscous_damping_pw=0.4,
)
"""Numbers of Table 1 that differ clearly between p-p and p-w; there the two rolling dampings are equal."""
PARAMETERS = {"DENS": 2500.0, "MU_PP": 0.35, "MU_PW": 0.15, "RF_PP": 0.04, "RF_PW": 0.09, "YM": 5e8}


def proof_model() -> AngleOfReposeModel:
    """10 mm beads of nominal stiffness, other wall constants, and a time-step a tenth of the deck's.

    Stiff beads keep overlaps (relative error of a lever arm or a fall height) below a thousandth of the
    radius; the small time-step divides the shortest collision into some 300 steps.
    """
    model = load_model(FIXED, "tiny")
    return replace(
        model,
        fidelity=replace(model.fidelity, softening=1.0, time_step_share=0.025),
        variant=replace(model.variant, wall_youngs_modulus=2e9, wall_poissons_ratio=0.4),
    )


MODEL = proof_model()


@dataclass(frozen=True)
class Bead:
    """Where a bead starts, how fast and with which spin (SI units)."""

    at: tuple[float, float, float]
    speed: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def lines(self, atom: int) -> list[str]:
        """Commands that make it."""
        values = zip(("vx", "vy", "vz", "omegax", "omegay", "omegaz"), (*self.speed, *self.spin), strict=True)
        set_values = " ".join(f"{name} {value!r}" for name, value in values)
        return [
            "create_atoms 1 single {!r} {!r} {!r} units box".format(*self.at),
            f"set atom {atom} diameter ${{particle_diameter}} density ${{DENS}} {set_values}",
        ]


@dataclass(frozen=True)
class Motion:
    """What beads did: ``time`` (n,), and per column of COLUMNS an array (n, beads)."""

    time: np.ndarray
    values: np.ndarray
    marks: dict[str, str]
    directory: Path

    def __getattr__(self, name: str) -> np.ndarray:
        return self.values[..., COLUMNS.index(name)]

    def one(self, bead: int) -> "Motion":
        """The motion of one bead alone, columns of shape (n,)."""
        return replace(self, values=self.values[:, bead])


@dataclass(frozen=True)
class Bench:
    """Runs small scripts with one contact.in, each in a directory of its own."""

    program: Program
    root: Path
    model: AngleOfReposeModel = MODEL
    contact: str | None = None
    """Text in the place of the shipped contact.in."""

    @cached_property
    def _numbers(self) -> Iterable[int]:
        return itertools.count()

    def wall(self, name: str) -> str:
        """The deck's own command that makes a wall."""
        (found,) = re.findall(rf"^fix {name} all .*$", self.model.files["in.angle_of_repose"], re.MULTILINE)
        return found

    def walls(self) -> list[str]:
        """The deck's ring, cylinder and plate."""
        return [self.wall(name) for name in ("ring", "cylinder", "walls", "plate")]

    def run(
        self,
        beads: Iterable[Bead],
        seconds: float,
        *lines: str,
        parameters: dict[str, float] | None = None,
        after: Iterable[str] = (),
        frames: int = 400,
    ) -> Motion:
        """Let beads move for some time under the given commands; RunError where LIGGGHTS fails."""
        values = self.model.variables({**PARAMETERS, **(parameters or {})}, 1)
        step = float(values["engine_time_step"])
        every = max(1, round(seconds / step / frames))
        made = [line for k, bead in enumerate(beads, 1) for line in bead.lines(k)]
        script = [
            *made,
            *lines,
            "fix integrate all nve/sphere",
            "thermo 1000000000",
            f"dump seen all custom {every} seen.dump id {' '.join(COLUMNS)}",
            f'dump_modify seen format "%d {" ".join(["%.15g"] * len(COLUMNS))}"',
            f"run {every * frames}",
            *after,
            'print "calstudy: finished"',
        ]
        directory = self.root / f"run{next(self._numbers)}"
        directory.mkdir(parents=True)
        files = {**self.model.files, "in.proof": HEAD + "\n".join([*script, ""])}
        if self.contact is not None:
            files["contact.in"] = self.contact
        settings = [f"variable {name} index {text}" for name, text in values.items()]
        files["parameters.in"] = "\n".join([*settings, ""])
        for name, text in files.items():
            (directory / name).write_text(text)
        output = directory / "output.txt"
        done = run_process(
            self.program.command("in.proof"),
            directory=directory,
            output=output,
            time_limit=60,
            stop=threading.Event(),
            environment=dict(self.program.profile.environment),
        )
        if done.exit_code or "finished" not in (marks := markers(directory / "log.liggghts")):
            raise RunError(f"{directory}: {output.read_text(errors='replace')[-300:]}")
        steps, seen = _frames((directory / "seen.dump").read_text())
        if len(steps) != frames + 1 or seen.shape[1] != len(made) // 2:
            raise RunError(f"{directory}: a bead was lost")
        return Motion(steps * step, seen, marks, directory)


def _frames(text: str) -> tuple[np.ndarray, np.ndarray]:
    """Steps (n,) and values (n, beads, columns), beads in the order of their numbers."""
    steps, values = [], []
    for frame in text.split("ITEM: TIMESTEP\n")[1:]:
        head, _, body = frame.partition("ITEM: ATOMS")
        table = np.array([line.split() for line in body.splitlines()[1:]], float)
        steps.append(int(head.split()[0]))
        values.append(table[np.argsort(table[:, 0]), 1:])
    if len({v.shape for v in values}) != 1:
        raise RunError("beads were lost on the way")
    return np.array(steps), np.array(values)

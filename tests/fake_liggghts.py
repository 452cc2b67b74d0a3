#!/usr/bin/env python3
"""A stand-in for LIGGGHTS that speaks its files and knows no physics: a cone of beads in milliseconds.

Called like LIGGGHTS 3.8.0 (``-help``; ``-in SCRIPT -log FILE -echo none``), it reads parameters.in and
writes the log with the script's ``calstudy:`` lines, filled.dump and heap.dump. The cone's steepness
follows MU_PP and RF_PP, the number of beads that fill the cylinder follows the frictions, and both
scatter a little with the insertion seed: about 20 to 33 deg and 1450 to 1600 kg/m3 over the box.

Environment variables:

FAKE_LIGGGHTS          how it misbehaves, one of BEHAVIOURS; unset or empty: not at all
FAKE_LIGGGHTS_SHARE    share of the seeds that misbehave, 0 to 1; unset: all of them
FAKE_LIGGGHTS_SECONDS  sleeps that long before it writes any result
FAKE_LIGGGHTS_UNTIL    waits until that file exists, two minutes at most
FAKE_LIGGGHTS_LOG      file to which every run appends the name of its directory

``COMMAND`` is the command for --liggghts and CALSTUDY_LIGGGHTS.
"""

# pathlib takes longer to import than all the rest takes to run:
# ruff: noqa: PTH100, PTH102, PTH109, PTH110, PTH119, PTH123, PTH202, UP031

import math
import os
import shlex
import sys
import time

# Without site-packages the interpreter starts in a fraction of the time.
COMMAND = f"{shlex.quote(sys.executable)} -S {shlex.quote(os.path.abspath(__file__))}"

BEHAVIOURS = {
    "error": "prints an ERROR and exits with 1",
    "silent": "exits with 0 before the last line of the script",
    "truncated": "heap.dump is cut in the middle of a line",
    "hang": "starts a child, whose id is in child.pid, and sleeps with it for ten minutes",
    "killed": "ends itself by SIGKILL",
    "nan": "one position is nan",
    "fast": "one bead moves at 500 m/s",
    "shaking": "the heap still moves at the end",
    "not_full": "hardly any bead lay above the fill height",
    "flat": "one layer of beads is left",
    "empty": "no bead is left",
    "far": "one bead lies 1e300 m away",
    "round": "the heap is as round as the reference sphere, so the pictures cannot be measured",
    "no_dump": "heap.dump is not there",
    "no_log": "the log is not there",
    "log_is_a_folder": "a folder has the log's name",
    "no_mark": "the log lacks a number that the script prints",
    "garbled_mark": "a number in the log is none",
    "garbled_count": "the number of beads in heap.dump is none",
    "negative_count": "the log says that a negative number of beads was poured",
    "other_count": "the log says another number of beads than heap.dump holds",
    "more_beads": "the heap holds more beads than filled the cylinder",
    "endless_number": "a number in the log has ten thousand digits",
    "binary": "log and dumps hold bytes that are no text",
    "exploded": "all but a few beads were thrown out of the box while they were poured",
    "vanished": "no bead is left after pouring",
    "outside": "a bead of the filling lies beside the cylinder",
    "directory_gone": "the run's directory is removed before the run ends",
    "wrong_version": "answers -help as another version of LIGGGHTS-PUBLIC; runs well",
    "no_liggghts": "answers -help as another program; runs well",
}
BANNER = "LIGGGHTS (Version LIGGGHTS-PUBLIC {}, compiled 2022-01-26-19:42:32 by nobody, git commit unknown)"
HEAP_RADIUS = 0.0485
MEASURED_RADIUS = 0.045
"""About what Appendix A makes of HEAP_RADIUS, so that the angle comes out as asked."""


def begun(log):
    """Identities of the DEM runs that were started, by the file that FAKE_LIGGGHTS_LOG names."""
    return [line.partition(".")[0] for line in log.read_text().split()]


def wait_for(path, seconds=120):
    end = time.monotonic() + seconds
    while not os.path.exists(path) and time.monotonic() < end:
        time.sleep(0.05)


def main(arguments):
    behaviour = os.environ.get("FAKE_LIGGGHTS", "")
    if behaviour and behaviour not in BEHAVIOURS:
        raise SystemExit(f"FAKE_LIGGGHTS={behaviour} is unknown; use one of {', '.join(BEHAVIOURS)}")
    banner = BANNER.format("3.7.0" if behaviour == "wrong_version" else "3.8.0")
    if arguments == ["-help"]:
        with open("log.liggghts", "w") as log:  # as the real one does, over whatever is there
            log.write(banner + "\n")
        print("LAMMPS (2 Aug 2023)" if behaviour == "no_liggghts" else banner)
        return
    options = dict(zip(arguments[::2], arguments[1::2], strict=True))
    if set(options) != {"-in", "-log", "-echo"}:
        raise SystemExit("ERROR: Invalid command-line argument")
    with open(options["-in"]) as script, open("parameters.in") as settings:
        if "include parameters.in" not in script.read():
            raise SystemExit("ERROR: the script does not include parameters.in")
        values = dict(line.split()[1:4:2] for line in settings)
    if log := os.environ.get("FAKE_LIGGGHTS_LOG"):
        with open(log, "a") as file:
            file.write(os.path.basename(os.getcwd()) + "\n")
    seed = int(values["seed_insertion"])
    if noise(seed, 3) >= float(os.environ.get("FAKE_LIGGGHTS_SHARE", "1")):
        behaviour = ""
    time.sleep(float(os.environ.get("FAKE_LIGGGHTS_SECONDS", "0")))
    if until := os.environ.get("FAKE_LIGGGHTS_UNTIL"):
        wait_for(until)
    if behaviour == "killed":
        os.kill(os.getpid(), 9)
    if behaviour == "hang":
        hang()
    if behaviour == "directory_gone":
        import shutil

        shutil.rmtree(os.getcwd())
        return
    run(behaviour, {name: float(value) for name, value in values.items()}, seed, options["-log"], banner)


def run(behaviour, value, seed, log, banner):
    if behaviour == "error":
        write(log, [banner, "ERROR: Particle overlap is too large (../pair_fake.cpp:7)", ""])
        print("ERROR: Particle overlap is too large (../pair_fake.cpp:7)")
        raise SystemExit(1)
    filled, angle = response(value, seed)
    if behaviour == "not_full":
        filled = int(value["poured_beads"])
    packed = packing(filled, value["particle_diameter"])
    heap = cone(0.0 if behaviour == "flat" else angle, value["particle_diameter"], seed)[:filled]
    if behaviour == "empty":
        heap = []
    if behaviour == "more_beads":
        packed = packed[: len(heap) // 2]
    if behaviour in ("exploded", "vanished"):
        packed = heap = packed[: 4 * (behaviour == "exploded")]
    if behaviour == "outside":
        packed[7] = (0.0551, 0.0, 0.005)
    speed = 500.0 if behaviour == "fast" else 0.0
    if behaviour == "nan":
        heap[7] = (math.nan, 0.0, 0.0)
    if behaviour == "far":
        heap[7] = (1e300, 0.0, 0.005)
    if behaviour == "round":
        heap = [(0.045 * math.cos(k / 50), 0.045 * math.sin(k / 50), 0.005) for k in range(315)] + heap
    write("filled.dump", dump(packed, 0.0))
    lines = dump(heap, speed)
    if behaviour == "garbled_count":
        lines[3] = "many"
    if behaviour != "no_dump":
        write("heap.dump", lines)
    if behaviour == "truncated":
        os.truncate("heap.dump", os.path.getsize("heap.dump") // 2)
    poured = max(int(value["poured_beads"]), len(packed) + 9 * (behaviour != "not_full"))
    if behaviour in ("exploded", "vanished"):
        poured = len(packed) + 3 * (behaviour == "exploded")
    if behaviour == "negative_count":
        poured = -poured
    marks = {
        "beads_poured": poured,
        "beads_filled": len(packed),
        "lift_intervals": 60,
        "simulated_time": "soon" if behaviour == "garbled_mark" else 3.9 + 1e-3 * noise(seed, 5),
        "kinetic_energy": 1.2e-9 if behaviour != "shaking" else 1e-3,
        "beads_heap": len(heap) + (behaviour == "other_count"),
        "finished": "",
    }
    if behaviour == "endless_number":
        marks["beads_heap"] = "9" * 10_000
    if behaviour == "silent":
        del marks["finished"]
    if behaviour == "no_mark":
        del marks["beads_filled"]
    if behaviour == "log_is_a_folder":
        os.mkdir(log)
    elif behaviour != "no_log":
        write(log, [banner, *(f"calstudy: {name} {number}".rstrip() for name, number in marks.items()), ""])
    if behaviour == "binary":
        for name in (log, "filled.dump", "heap.dump"):
            with open(name, "r+b") as file:
                file.write(b"\xff\xfe\x00")


def response(value, seed):
    """Number of beads that fill the cylinder, and angle of repose in deg."""
    mu = (value["MU_PP"] - 0.1) / 0.2
    wall = (value["MU_PW"] - 0.1) / 0.2
    rolling = (value["RF_PP"] - 0.001) / 0.099
    diameter = value["particle_diameter"]
    share = 0.626 - 2.0 * diameter - 0.010 * mu - 0.003 * wall - 0.002 * rolling
    share += 0.002 * (noise(seed, 1) - 0.5)
    # Far outside the box the packing stays one that exists, and the heap one that fits its picture.
    share = min(max(share, 0.5), 0.7)
    volume = math.pi / 4 * 0.1**2 * value["fill_height"]
    angle = 21.9 + 5.6 * mu + 3.5 * rolling + 1.2 * (noise(seed, 2) - 0.5)
    return round(share * volume / (math.pi / 6 * diameter**3)), min(max(angle, 5.0), 50.0)


def packing(count, diameter):
    """Beads spread evenly over the cylinder below the fill height; they overlap, which nobody looks at."""
    reach, rise = 0.05 - diameter / 2, 0.05 - diameter
    for_each = ((k, (k + 0.5) / count) for k in range(count))
    return [
        (
            reach * math.sqrt(k * 0.7548776662466927 % 1) * math.cos(2.399963 * k),
            reach * math.sqrt(k * 0.7548776662466927 % 1) * math.sin(2.399963 * k),
            diameter / 2 + rise * height,
        )
        for k, height in for_each
    ]


def cone(angle, diameter, seed):
    """Layers of a hexagonal grid, each smaller than the one below; the top bead makes the height."""
    height = MEASURED_RADIUS * math.tan(math.radians(angle))
    layers = math.ceil(height / (0.8 * diameter))
    pitch, turn = 0.9 * diameter, 2 * math.pi * noise(seed, 4)
    reach = math.ceil(2 * HEAP_RADIUS / pitch)
    grid = [
        (pitch * (i + 0.5 * j), pitch * math.sqrt(0.75) * j)
        for i in range(-reach, reach + 1)
        for j in range(-reach, reach + 1)
    ]
    beads = []
    for n in range(layers + 1):
        radius = (HEAP_RADIUS - diameter / 2) * (1 - n / layers if layers else 1)
        z = diameter / 2 + (height * n / layers if layers else 0)
        beads += [
            (x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn), z)
            for x, y in grid
            if math.hypot(x, y) <= radius
        ]
    return beads


def dump(beads, speed):
    head = ["ITEM: TIMESTEP", "15775", "ITEM: NUMBER OF ATOMS", str(len(beads)), "ITEM: BOX BOUNDS ff ff ff"]
    head += ["-0.065 0.065", "-0.065 0.065", "-0.001 0.2", "ITEM: ATOMS id x y z vx vy vz "]
    # LIGGGHTS writes beads in the order of its bins; here the later ones come first.
    numbered = [(k + 1, *bead) for k, bead in enumerate(beads)][::-1]
    body = ["%d %g %g %g %g %g %g " % (*bead, 1e-6, -2e-6, 3e-6) for bead in numbered]
    if speed:
        body[3] = "%d %g %g %g 0 0 %g " % (*numbered[3], -speed)
    return [*head, *body, ""]


def noise(seed, stream):
    """A number in [0; 1) that looks random."""
    state = seed * 4 + stream
    for _ in range(4):
        state = (state * 6364136223846793005 + 1442695040888963407) % 2**64
        state ^= state >> 29
    return (state >> 11) / 2**53


def write(name, lines):
    with open(name, "w") as file:
        file.write("\n".join(lines))


def hang():
    import subprocess

    child = subprocess.Popen(["sleep", "600"])
    write("child.pid", [str(child.pid)])
    time.sleep(600)


if __name__ == "__main__":
    main(sys.argv[1:])

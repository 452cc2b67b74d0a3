"""The command ``advise``: what each test would tell, before it is made."""

from __future__ import annotations

import shlex
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from calstudy.cli.terminal import messages_console, print_json, print_paths, results_console, say
from calstudy.emulator.advice.advice import advise as simulate
from calstudy.emulator.advice.advice import emulators_by_test, known_responses, question_of
from calstudy.emulator.emulator import read_emulator
from calstudy.errors import InputError
from calstudy.report.advice.tables import as_json, print_advice, write_advice
from calstudy.study.definition import Definition, read_definition
from calstudy.study.directory.begun import begun_with
from calstudy.study.reading import Result, read_result
from calstudy.study.settings import SETTINGS_FILE, read_settings
from calstudy.study.stored import stored_in
from calstudy.written import choice, number_in


def advise(a: Namespace) -> None:
    """Simulate calibrations with each test that is not in the file yet, and say what they leave."""
    console = messages_console()
    given = [read_emulator(directory) for directory in a.emulator]
    # Options are refused before the shipped emulators are read, which takes longer than all else here.
    known = known_responses(given)
    only = None if a.tests is None else _tests(a.tests, known)
    errors = _errors(a.error, known)
    definition, result = _file(a)
    question = question_of(definition, result, emulators_by_test(given), errors, only)
    with threadpool_limits(1):  # matrices this small gain nothing from more
        advice = simulate(question, lambda done, of: say(console, f"{done} of {of} calibrations simulated"))
    words = ["calstudy", "advise", *([str(a.file)] if a.file else [])]
    written = write_advice(advice, a.out, shlex.join(words))
    if a.json:
        print_json(as_json(advice) | {"written": [str(path) for path in written]})
        return
    out = results_console()
    print_advice(out, advice)
    print_paths(out, "Page, tables and pictures:", written)


def _file(a: Namespace) -> tuple[Definition | None, Result | None]:
    """The file's definition, and the result of its study where that is finished; None where there is none."""
    if a.file is None:
        if a.study is not None:
            raise InputError("--study is the study of a FILE.toml; name the file, too")
        return None, None
    directory = a.study or Path("studies") / a.file.stem
    definition = read_definition(a.file, a.models, a.force, *begun_with(directory))
    if not (directory / SETTINGS_FILE).exists():
        if a.study is not None:
            raise InputError(f"{directory} holds no study; run calstudy calibrate {a.file}, or leave it out")
        return definition, None
    settings = read_settings(directory)
    definition = definition.taking_over(stored_in(settings))
    if settings.plan_hash != definition.hash:
        raise InputError(
            f"{directory} is the study of another file than {a.file} as it is now; name another --study, or "
            "calibrate the file as it is"
        )
    result = read_result(directory, definition, settings)
    if result is None:
        raise InputError(f"{directory}: the calibration failed, so it has no solution space; name another")
    return definition, result


def _tests(text: str, known: Mapping[str, Sequence[str]]) -> list[str]:
    """Names in ``--tests``."""
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if name not in known:
            raise InputError(f"--tests: there is no emulator of {name}; {choice(name, known, 'there are')}")
    return names


def _errors(given: Sequence[str], known: Mapping[str, Sequence[str]]) -> dict[tuple[str, str], float]:
    """Errors of ``--error``, by test and response."""
    found = {}
    for text in given:
        name, equals, number = (part.strip() for part in text.partition("="))
        test, _, response = name.partition(".")
        if test not in known or not equals:
            remedy = choice(test, known, "TEST is one of")
            raise InputError(f"--error {text}: use TEST.RESPONSE=SD; {remedy}")
        if response not in known[test]:
            remedy = choice(response, known[test], "there are")
            raise InputError(f"--error {text}: {test} has no response {response}; {remedy}")
        try:
            found[test, response] = number_in(number)
        except InputError as error:
            raise InputError(f"--error {text}: {error}") from error
        if not found[test, response] > 0:
            raise InputError(f"--error {text}: an error is above 0")
    return found

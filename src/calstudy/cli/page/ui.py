"""The command ``ui``: the calibration in the browser."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from calstudy.cli.calibrate import EXAMPLE_NAME
from calstudy.errors import InputError, SetupError
from calstudy.written import text_of

NEEDS = "the page needs NiceGUI; install it: pip install 'calstudy[ui]'"


def ui(a: Namespace) -> None:
    """Serve the page of a calibration until it is interrupted."""
    try:
        import nicegui  # noqa: F401
    except ImportError as error:
        raise SetupError(NEEDS) from error
    from calstudy.study.run.project import STUDY, Project
    from calstudy.ui.server import serve

    given = a.project.absolute()
    file = given if given.suffix == ".toml" else given / EXAMPLE_NAME
    if not file.parent.is_dir():
        raise InputError(f"{file.parent} is no directory; make it, or name another")
    chosen = file.parent / STUDY
    before = Path(text_of(chosen)) if chosen.exists() else file.parent / "studies" / file.stem
    study = (a.study or before).absolute()
    project = Project(
        file,
        study,
        running=_running(a),
        common=_common(a),
        program=["--liggghts", a.liggghts] if a.liggghts else [],
        models=[path.absolute() for path in a.models],
        insist=a.force,
    )
    serve(project, a.port, not a.no_browser)


def _common(a: Namespace) -> list[str]:
    """Options that ``calibrate`` and ``try`` are given, with paths that hold in any directory."""
    words = [word for path in a.models for word in ("--models", str(path.absolute()))]
    words += ["--ranks", str(a.ranks)] if a.ranks else []
    return words + (["--force"] if a.force else [])


def _running(a: Namespace) -> list[str]:
    """Options that ``calibrate`` alone is given."""
    words = [word for path in a.emulator for word in ("--emulator", str(path.absolute()))]
    return words + (["--workers", str(a.workers)] if a.workers else [])

"""The command ``analyse``: reads a study, writes its report, says where it lies."""

from __future__ import annotations

from argparse import Namespace

from calstudy.cli.terminal import print_json, results_console
from calstudy.engines.queue import cores
from calstudy.report.exhibits import asked_for, chosen
from calstudy.report.export import FORMATS, lead, write_analysis


def analyse(a: Namespace) -> None:
    """Regenerate tables and figures."""
    exhibits, formats = asked_for(a.study, a.only, a.beside), chosen("--format", a.format, FORMATS)
    out_directory = a.out or a.study / "analysis"
    study, written = write_analysis(a.study, a.plan, out_directory, exhibits, formats, cores(), a.beside)
    if a.json:
        print_json(
            written.manifest | {"verdicts": written.verdicts, "written": [str(p) for p in written.files]}
        )
        return
    out = results_console()
    out.print(f"{lead(study, written.verdicts)} {study.provenance()}", highlight=False, soft_wrap=True)
    shown = [path for path in written.files if path.name in ("report.html", "manifest.json")]
    for path in shown:
        out.print(f"  {path}", highlight=False, soft_wrap=True)
    folders = {path.parent for path in written.files if path not in shown}
    for folder in sorted(folders):
        count = sum(path.parent == folder for path in written.files)
        out.print(f"  {folder}: {count} files", highlight=False, soft_wrap=True)

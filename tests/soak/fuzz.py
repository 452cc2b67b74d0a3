"""Every reader on corrupted files: it reads, or says in one line what is wrong; nothing else may happen."""

import hashlib
import json
import shutil
import zlib
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from beads_in_a_box import MODEL, SCRIPT
from calstudy.disk.kept import KeptRuns
from calstudy.emulator.benchmark.campaign import Piece, keep, kept, lines_of
from calstudy.emulator.emulator import read_emulator, shipped_emulator
from calstudy.errors import CalstudyError
from calstudy.models.folder.curves import Columns, Curve
from calstudy.models.folder.file import load_folder
from calstudy.models.photograph.marked import read_marks
from calstudy.models.photograph.photographs import read_photograph
from calstudy.models.photograph.rules import read_beads
from calstudy.models.silhouette import read_picture
from calstudy.models.targets import read_twins, twin_columns
from calstudy.plan_file import load_plan
from calstudy.report.card.card import read_card
from calstudy.report.replicated import ENTRIES_FILE, MANIFEST_FILE, read_entries
from calstudy.study.definition import read_definition
from calstudy.study.definition.curves import read_curve
from calstudy.study.definition.examples import example
from calstudy.study.directory.journal import read_journal
from calstudy.study.directory.session import holder, read_sessions
from calstudy.study.reading import read_study
from calstudy.study.settings import read_settings
from calstudy.study.status import read_status
from calstudy.study.sweep import DESIGN_COLUMNS, read_design
from calstudy.tomlfile import read_toml
from closed_form import run_study

REPORTS = Path(__file__).parent.parent.parent / "reports"
STRESS = Curve("Pa", "strain", "-", Columns("run.txt", 1, 2))
DESIGN = f"{','.join(DESIGN_COLUMNS)}\na,tiny,ring,1,2500,0.2,0.2,0.05,0.01,5.06e8\n"


def subjects(folder: Path):
    """Each reader by its name: a valid file, and what reads it."""
    study = folder / "study"
    run_study(study, (53,))
    shutil.copytree(shipped_emulator("angle_of_repose", "soft", "ring"), folder / "emulator")
    (folder / "design.csv").write_text(DESIGN)
    (folder / "file.toml").write_text(example())
    (folder / "twins.csv").write_text(",".join(twin_columns(("MU",), ("angle",))) + "\n")
    picture = np.full((40, 40), 255, np.uint8)
    picture[20:, 10:30] = 0
    cv2.imwrite(str(folder / "picture.png"), picture)
    (folder / "lock").write_bytes((study / "sessions.jsonl").read_bytes())
    shutil.copy(REPORTS / "materials" / "glass_beads_heap.json", folder / "material.json")
    (folder / "curve.csv").write_text("strain [-],stress [kPa],sd [kPa]\n0.1,1,0.1\n0.2,3,0.1\n0.3,9,0.2\n")
    (folder / "box").mkdir()
    (folder / "box" / "in.box").write_text(SCRIPT)
    (folder / "box" / "model.toml").write_text(MODEL)
    (folder / "ran").mkdir()
    (folder / "ran" / "log").write_text("beads = 40\n" * 20)
    runs_kept = KeptRuns(folder / "kept")
    assert runs_kept.keep("a", {"outcome": "ok"}, folder / "ran", {})
    (folder / "marks.json").write_text(
        json.dumps({"a.png": {"points": [[0, 0], [1, 1], [2, 0], [3, 3]], "by_hand": True, "mm": 5.0}})
    )
    piece = Piece("random", "flat", (1,), (8.0,))
    keep(lines_of(piece), piece.path(folder))
    replicated = REPORTS / "emulated" / "soft-ring"
    (folder / "replicated").mkdir()
    for name in (ENTRIES_FILE, MANIFEST_FILE):
        shutil.copy(replicated / name, folder / "replicated")
    row = "row-53"
    plan = Path(str(load_plan().origin)) if Path(str(load_plan().origin)).is_file() else None
    found = {
        "study.json": (study / "study.json", lambda p: read_settings(p.parent)),
        "calibrations": (study / "calibrations" / f"{row}.parquet", lambda p: read_study(study)),
        "evaluations": (study / "evaluations" / f"{row}.parquet", lambda p: read_status(study)),
        "heaps": (study / "heaps" / f"{row}.parquet", lambda p: read_study(study)),
        "journal": (study / "journal" / f"{row}.jsonl", read_journal),
        "sessions": (study / "sessions.jsonl", lambda p: read_sessions(p.parent)),
        "lock": (folder / "lock", lambda p: holder(p.parent)),
        "emulator.json": (folder / "emulator" / "emulator.json", lambda p: read_emulator(p.parent)),
        "emulator's runs": (folder / "emulator" / "runs.parquet", lambda p: read_emulator(p.parent)),
        "design": (folder / "design.csv", read_design),
        "TOML": (folder / "file.toml", read_toml),
        "calibration": (folder / "file.toml", read_definition),
        "twins": (folder / "twins.csv", lambda p: read_twins(p, twin_columns(("MU",), ("angle",)))),
        "picture": (folder / "picture.png", read_picture),
        "photograph": (folder / "picture.png", read_photograph),
        "beads": (study / "heaps" / f"{row}.parquet", read_beads),
        "marks": (folder / "marks.json", read_marks),
        "benchmark": (piece.path(folder), lambda p: kept(piece, folder)),
        "material card": (folder / "material.json", read_card),
        "measured curve": (folder / "curve.csv", lambda p: read_curve(p, STRESS)),
        "own model": (folder / "box" / "model.toml", lambda p: load_folder(p.parent)),
        "kept run": (folder / "kept" / "a.tar.gz", lambda p: _unpacked(runs_kept, folder / "unpacked")),
        "entries": (folder / "replicated" / ENTRIES_FILE, lambda p: _entries(p.parent)),
        "manifest": (folder / "replicated" / MANIFEST_FILE, lambda p: read_entries(p.parent)),
    }
    if plan:
        shutil.copy(plan, folder / "plan.csv")
        found["plan"] = (folder / "plan.csv", load_plan)
    return found


def _unpacked(kept: KeptRuns, into: Path):
    """What a kept run tells and holds; damaged, it is none."""
    if kept.about("a") is None or not kept.unpack("a", into):
        raise CalstudyError("is no run")


def _entries(folder: Path):
    """Entries that the manifest lists with the checksum that they have."""
    manifest = json.loads((folder / MANIFEST_FILE).read_text())
    manifest["files"][ENTRIES_FILE] = hashlib.sha256((folder / ENTRIES_FILE).read_bytes()).hexdigest()
    (folder / MANIFEST_FILE).write_text(json.dumps(manifest))
    read_entries(folder)


KINDS = ("flip", "cut", "insert", "repeat", "drop")
EDITS = st.lists(
    st.tuples(st.sampled_from(KINDS), st.floats(0, 1), st.binary(max_size=8)),
    min_size=1,
    max_size=4,
)  # fmt: skip


def edited(content: bytes, edits) -> bytes:
    """Content after edits, each at a share of its length."""
    for kind, share, new in edits:
        place = int(share * len(content))
        if kind == "flip" and place < len(content):
            content = (
                content[:place] + bytes([content[place] ^ (new[0] if new else 1)]) + content[place + 1 :]
            )
        elif kind == "cut":
            content = content[:place]
        elif kind == "insert":
            content = content[:place] + new + content[place:]
        elif kind == "repeat":
            content = content[:place] + content[place : place + 64] * 3 + content[place:]
        elif kind == "drop":
            content = content[:place] + content[place + 16 :]
    return content


def resealed(content: bytes) -> bytes:
    """A journal whose edited lines have checksums that agree."""
    texts = [line[9:] for line in content.split(b"\n")]
    return b"\n".join(b"%08x %s" % (zlib.crc32(text), text) for text in texts)


def _corrupt(name, path, read, cases, found):
    """Read a file that often, each time with other edits."""
    whole = path.read_bytes()

    @settings(
        max_examples=cases,
        deadline=None,
        database=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )
    @given(edits=EDITS)
    def one(edits):
        content = edited(whole, edits)
        path.write_bytes(resealed(content) if "anew" in name else content)
        found["cases"] += 1
        try:
            read(path)
            found["read"] += 1
        except CalstudyError as error:
            assert "\n" not in str(error), f"{name}: {error}"
            found["refused in one line"] += 1

    one()


def check(folder: Path, cases: int) -> dict[str, int]:
    """Read ``cases`` corrupted files; AssertionError for anything but an answer or a line that says why."""
    found: Counter[str] = Counter()
    readers = subjects(folder)
    readers["journal, checksums anew"] = readers["journal"]
    each = -(-cases // len(readers))
    for name, (path, read) in readers.items():
        whole = path.read_bytes()
        try:
            _corrupt(name, path, read, each, found)
        finally:
            path.write_bytes(whole)
    return {"readers": len(readers), **found}

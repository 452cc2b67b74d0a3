import contextlib
import json
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from calstudy import __version__
from calstudy.errors import SetupError, StoreError
from calstudy.models.heap import RESPONSES
from calstudy.plan import PARAMETERS
from calstudy.records import Beads, Evaluation, Outcome, Phase, Request, Run
from calstudy.study.directory.begun import version_there
from calstudy.study.directory.journal import encode
from calstudy.study.directory.store import Store, read_part, read_table
from calstudy.study.schema import TABLES, arrow_schema, evaluation_line
from calstudy.study.settings import SETTINGS_FILE, read_settings
from closed_form import TRUTH, ClosedForm, identify, run_study, study_settings, wait_for
from shipped_model import COLUMNS, QUANTITIES

law = settings(max_examples=15, deadline=None)
numbers = st.floats(allow_infinity=False)
finite = st.floats(allow_nan=False, allow_infinity=False)
counts = st.integers(0, 10**6)


@st.composite
def evaluations(draw, row=3):
    heap = draw(
        st.none()
        | arrays.arrays(
            np.float32, st.tuples(st.integers(0, 5), st.just(3)), elements=st.floats(-1, 1, width=32)
        )
    )
    run = Run(
        outcome=draw(st.sampled_from(Outcome)),
        reason=draw(st.text(max_size=30)),
        responses={name: draw(numbers) for name in RESPONSES},
        wall_time=draw(numbers),
        cpu_time=draw(numbers),
        radius=draw(numbers),
        height=draw(numbers),
        beads=draw(st.none() | st.builds(Beads, counts, counts, counts, counts)),
        simulated_time=draw(numbers),
        positions=heap,
        host=draw(st.text(max_size=9)),
        finished_at=draw(st.text(max_size=9)),
    )
    request = Request(
        row=row,
        phase=draw(st.sampled_from(Phase)),
        index=draw(counts),
        parameters={name: draw(finite) for name in PARAMETERS},
        seed=draw(st.integers(1, 2**31)),
    )
    return Evaluation(request, identify(request), run)


def an_evaluation(index=0, phase=Phase.SAMPLING, row=3):
    request = Request(row, phase, index, {**TRUTH, "MU_PP": 0.1 + 0.01 * index}, 11)
    run_id = identify(request)
    run = ClosedForm().run(request.parameters, request.seed, Named(run_id), stop=None)
    return Evaluation(request, run_id, run)


class Named:
    def __init__(self, name):
        self.name = name


def plain(run):
    """A run as values that compare equal when they are the same, NaN included."""
    fields = {name: getattr(run, name) for name in Run.__slots__ if name != "positions"}
    beads = None if run.positions is None else np.asarray(run.positions, float).tolist()
    return repr({**fields, "responses": dict(run.responses), "positions": beads})


def same(found, recorded):
    return (
        found.request == recorded.request
        and found.run_id == recorded.run_id
        and plain(found.run) == plain(recorded.run)
    )


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "study", study_settings()) as opened:
        yield opened


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    directory = tmp_path_factory.mktemp("studies") / "study"
    run_study(directory, (1, 5))
    return directory


# ---- the journal ---------------------------------------------------------------------------------


@law
@given(recorded=st.lists(evaluations(), min_size=1, max_size=4))
def test_what_is_recorded_is_read_back(tmp_path_factory, recorded):
    directory = tmp_path_factory.mktemp("studies") / "study"
    with Store(directory, study_settings()) as store:
        for evaluation in recorded:
            store.record(evaluation)
    with Store(directory, study_settings()) as store:
        found = store.journal(3)
        assert store.notes == [] and store.journal(4) == []
    assert len(found) == len(recorded)
    assert all(same(one, evaluation) for one, evaluation in zip(found, recorded, strict=True))


def test_a_journal_keeps_the_names_of_the_versions_before():
    stored = json.loads(encode(an_evaluation()).partition(b" ")[2])["run"]
    assert stored["beads"] == {"poured": 60, "filled": 50, "heap": 40, "lost": 10}
    assert isinstance(stored["heap"], str) and "positions" not in stored


def test_a_run_that_differs_in_one_number_is_not_the_same(store):
    recorded = an_evaluation()
    store.record(recorded)
    (found,) = store.journal(3)
    other = replace(recorded.run, radius=np.nextafter(recorded.run.radius, 1))
    assert same(found, recorded)
    assert not same(found, replace(recorded, run=other))


def test_a_journal_cut_at_any_byte_loses_the_last_line_alone_and_goes_on(store):
    recorded = [an_evaluation(k, phase) for k, phase in enumerate(Phase)]
    for evaluation in recorded[:3]:
        store.record(evaluation)
    path = store.directory / "journal" / "row-03.jsonl"
    whole = path.read_bytes()
    last = whole.rstrip(b"\n").rindex(b"\n") + 1
    for cut in [*range(last, len(whole) - 12, 23), *range(len(whole) - 12, len(whole))]:
        path.write_bytes(whole[:cut])
        store.notes.clear()
        store.record(recorded[3])
        found = store.journal(3)
        kept = recorded[:2] if cut < len(whole) - 1 else recorded[:3]
        assert [one.request for one in found] == [e.request for e in [*kept, recorded[3]]]
        assert len(store.notes) == (last < cut < len(whole) - 1)


@law
@given(data=st.data())
def test_a_flipped_byte_leaves_out_its_line_and_is_noted(tmp_path_factory, data):
    directory = tmp_path_factory.mktemp("studies") / "study"
    recorded = [an_evaluation(k) for k in range(3)]
    with Store(directory, study_settings()) as store:
        for evaluation in recorded:
            store.record(evaluation)
        path = directory / "journal" / "row-03.jsonl"
        content = bytearray(path.read_bytes())
        place = data.draw(st.integers(0, len(content) - 1).filter(lambda k: content[k] != ord("\n")))
        content[place] ^= 1 << data.draw(st.integers(0, 7))
        line = bytes(content[:place]).count(b"\n")
        path.write_bytes(bytes(content))
        found = [one.request for one in store.journal(3)]
        assert found == [e.request for k, e in enumerate(recorded) if k != line]
        assert len(store.notes) == 1 and "row-03.jsonl" in store.notes[0] and "run again" in store.notes[0]


def test_lines_that_come_while_the_disk_is_busy_are_forced_to_it_together(store, monkeypatch):
    evaluations = [an_evaluation(index) for index in range(9)]
    store.record(evaluations[0])  # makes the file, whose name is forced to disk, too
    busy, free = threading.Event(), threading.Event()
    forced: list[int] = []
    force = os.fsync

    def slow(handle):
        busy.set()
        assert free.wait(30)
        forced.append(os.fstat(handle).st_size)
        force(handle)

    monkeypatch.setattr(os, "fsync", slow)
    with ThreadPoolExecutor(8) as threads:
        first = threads.submit(store.record, evaluations[1])
        assert busy.wait(30)
        others = [threads.submit(store.record, evaluation) for evaluation in evaluations[2:]]
        journal = store._journals[3]
        wait_for(lambda: len(journal._waiting) == 7)
        assert not first.done() and not any(other.done() for other in others), (
            "nothing counts before the disk"
        )
        free.set()
        for ended in (first, *others):
            ended.result(30)
    assert len(forced) == 2, "one line, then seven"
    assert {e.run_id for e in store.journal(3)} == {e.run_id for e in evaluations}


def test_every_line_of_a_group_hears_that_the_disk_is_full(store, monkeypatch):
    started, go_on = threading.Event(), threading.Event()

    def full(_):
        started.set()
        assert go_on.wait(30)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with ThreadPoolExecutor(3) as threads:
        recorded = [threads.submit(store.record, an_evaluation(0))]
        assert started.wait(30)
        recorded += [threads.submit(store.record, an_evaluation(index)) for index in (1, 2)]
        wait_for(lambda: len(store._journals[3]._waiting) == 2)
        go_on.set()
    assert all(isinstance(one.exception(), SetupError) for one in recorded)


def test_a_full_disk_is_a_setup_error_that_names_the_journal(store, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(SetupError, match=r"row-03\.jsonl: cannot be written: No space left on device; free"):
        store.record(an_evaluation())


# ---- finished rows -------------------------------------------------------------------------------


def test_one_thread_encodes_the_tables_of_all_rows(tmp_path, monkeypatch):
    """Arrow keeps megabytes for each thread that encodes one, and a study has a thread for each row."""
    encode_table, threads = pq.write_table, []

    def noted(*arguments, **options):
        threads.append(threading.get_ident())
        encode_table(*arguments, **options)

    monkeypatch.setattr(pq, "write_table", noted)
    with Store(tmp_path / "study", study_settings()) as store, ThreadPoolExecutor(4) as rows:
        all_there = threading.Barrier(4)

        def finish(row):
            all_there.wait()
            store.finish(row, {"outcome": "ok"}, [an_evaluation(row=row)], [])

        list(rows.map(finish, (1, 2, 3, 4)))
        assert store.finished_rows() == {1, 2, 3, 4}
    assert len(threads) == 8 and len(set(threads)) == 1


def test_an_open_study_knows_its_failed_rows_without_reading_a_table_again(tmp_path, monkeypatch):
    directory = tmp_path / "study"
    with Store(directory, study_settings()) as store:
        for row, outcome in ((1, "ok"), (2, "failed"), (3, "failed")):
            evaluation = an_evaluation(row=row)
            store.record(evaluation)
            store.finish(row, {"outcome": outcome}, [evaluation], [])
    with Store(directory, study_settings()) as again:
        monkeypatch.setattr("calstudy.study.directory.store.read_part", None)
        assert again.failed_rows() == {2, 3}
        again.reopen(3)
        assert again.failed_rows() == {2}


@law
@given(recorded=st.lists(evaluations(), min_size=1, max_size=4), failed=st.booleans())
def test_finished_tables_equal_what_was_recorded(tmp_path_factory, recorded, failed):
    directory = tmp_path_factory.mktemp("studies") / "study"
    with Store(directory, study_settings()) as store:
        line = {"outcome": "failed" if failed else "ok", "runs_total": len(recorded)}
        best = [] if failed else [(recorded[0], 0.0075)]
        run_id = "" if failed else recorded[0].run_id
        store.finish(3, line, recorded, best)
        assert store.finished_rows() == {3}
        assert store.failed_rows() == ({3} if failed else set())
    table = read_table(directory, "evaluations")
    order = [list(Phase).index(Phase(phase)) for phase in table["phase"]]
    assert sorted(zip(order, table["index"], strict=True)) == list(zip(order, table["index"], strict=True))
    left = [evaluation_line(one) for one in recorded]
    for found in table.to_dict("records"):
        match = [one for one in left if one["run_id"] == found["run_id"] and agrees(one, found)]
        assert match
        left.remove(match[0])
    assert left == []
    assert set(table["study"]) == {study_settings().id} and set(table["row"]) == {3}
    heaps = read_table(directory, "heaps")
    if failed or recorded[0].run.positions is None:
        assert len(heaps) == 0
    else:
        assert heaps[["x", "y", "z"]].to_numpy().tolist() == recorded[0].run.positions.tolist()
        assert set(heaps["run_id"]) <= {run_id}


def agrees(line, found):
    return all(
        pd.isna(found[name]) if value is None or value != value else found[name] == value
        for name, value in line.items()
    )


def test_pandas_reads_the_tables_with_the_documented_columns(finished):
    for table, columns in COLUMNS.items():
        frame = pd.read_parquet(finished / table)
        assert list(frame) == [column.name for column in columns]
        pd.testing.assert_frame_equal(frame, read_table(finished, table))
    assert list(pd.read_parquet(finished / "calibrations")["row"]) == [1, 5]


def test_what_a_crash_left_beside_a_table_is_no_part_of_it(finished, tmp_path):
    litter = finished / "calibrations" / ".row-02.parquet.part"
    litter.write_bytes(b"PAR1 half of a")
    assert list(pd.read_parquet(finished / "calibrations")["row"]) == [1, 5]
    assert list(read_table(finished, "calibrations")["row"]) == [1, 5]
    litter.unlink()


def test_what_a_killed_session_wrote_of_a_row_counts_when_the_row_is_whole(tmp_path):
    run_study(tmp_path, (1, 5))
    (tmp_path / "calibrations" / "row-05.parquet").unlink()
    rows = {table: set(read_table(tmp_path, table)["row"]) for table in TABLES}
    assert rows == {table: {1} for table in TABLES}


def test_a_study_without_finished_rows_has_empty_tables(store):
    for table, columns in COLUMNS.items():
        frame = read_table(store.directory, table)
        assert (len(frame), list(frame)) == (0, [column.name for column in columns])


@pytest.mark.parametrize("length", [0, 3, 100, -1, -4, -100])
def test_a_table_cut_short_is_refused_by_name(finished, tmp_path, length):
    whole = (finished / "calibrations" / "row-01.parquet").read_bytes()
    (tmp_path / "calibrations").mkdir()
    (tmp_path / SETTINGS_FILE).write_bytes((finished / SETTINGS_FILE).read_bytes())
    (tmp_path / "calibrations" / "row-01.parquet").write_bytes(whole[:length])
    with pytest.raises(StoreError, match=r"^[^\n]*row-01\.parquet is damaged[^\n]*run it again$"):
        read_table(tmp_path, "calibrations", QUANTITIES)


def flipped(whole, place, bit):
    content = bytearray(whole)
    content[place] ^= 1 << bit
    return bytes(content)


@pytest.mark.parametrize("table", ["evaluations", "heaps"])
def test_a_flipped_byte_is_refused_by_name_or_changes_nothing(finished, tmp_path, table):
    whole = (finished / table / "row-01.parquet").read_bytes()
    schema = arrow_schema(table, QUANTITIES)
    sound = read_part(finished / table / "row-01.parquet", schema)
    path = tmp_path / "row-01.parquet"
    rng = np.random.default_rng(5)
    refused = 0
    for place in rng.choice(len(whole), 300, replace=False):
        path.write_bytes(flipped(whole, place, rng.integers(8)))
        try:
            assert read_part(path, schema).equals(sound)
        except StoreError as error:
            refused += 1
            assert "row-01.parquet" in str(error) and "\n" not in str(error)
    assert refused > 100


def test_no_flipped_byte_of_the_data_goes_unseen(finished, tmp_path):
    # The pages of x, y and z: the only place where a changed number could look like a sound one.
    whole = (finished / "heaps" / "row-01.parquet").read_bytes()
    schema = arrow_schema("heaps", QUANTITIES)
    sound = read_part(finished / "heaps" / "row-01.parquet", schema)
    path = tmp_path / "row-01.parquet"
    footer = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    for place in range(4, footer, 7):
        path.write_bytes(flipped(whole, place, place % 8))
        with contextlib.suppress(StoreError):
            assert read_part(path, schema).equals(sound)


@pytest.mark.parametrize("table", TABLES)
def test_no_flipped_bit_of_a_footer_changes_a_type_unseen(finished, tmp_path, table):
    whole = (finished / table / "row-01.parquet").read_bytes()
    schema = arrow_schema(table, QUANTITIES)
    sound = read_part(finished / table / "row-01.parquet", schema)
    path = tmp_path / "row-01.parquet"
    footer = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    for place in range(footer, footer + 60):
        for bit in (2, 4, 6):
            path.write_bytes(flipped(whole, place, bit))
            try:
                assert read_part(path, schema).equals(sound)
            except StoreError as error:
                assert "row-01.parquet" in str(error)


def test_columns_of_another_version_are_refused(finished, tmp_path):
    (tmp_path / "calibrations").mkdir()
    (tmp_path / SETTINGS_FILE).write_bytes((finished / SETTINGS_FILE).read_bytes())
    target = tmp_path / "calibrations" / "row-01.parquet"
    pd.read_parquet(finished / "calibrations" / "row-01.parquet").rename(
        columns={"WRL": "weight"}
    ).to_parquet(target)
    with pytest.raises(StoreError, match="columns are not those of this version"):
        read_table(tmp_path, "calibrations", QUANTITIES)


# ---- the study's settings ------------------------------------------------------------------------


def test_settings_are_read_back(store):
    assert read_settings(store.directory) == study_settings()
    assert read_settings(store.directory).id == study_settings().id


def test_known_noise_is_part_of_a_study_and_studies_without_it_keep_their_id(tmp_path):
    known = study_settings(mode="robust", noise={"angle_of_repose_deg": 1.1, "bulk_density": 3.0})
    with Store(tmp_path, known):
        assert read_settings(tmp_path) == known
    assert known.id != study_settings(mode="robust").id
    assert "noise" not in study_settings().content


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"seed": 8}, "the seed: 7 → 8"),
        ({"mode": "robust"}, "the mode: paper → robust"),
        ({"noise": {"bulk_density": 3.0}}, "the noise of bulk_density: none → 3"),
        ({"calstudy": "9"}, "the version of calstudy: test → 9.*take calstudy test and ask for its settings"),
        ({"deck": 2, "model_hash": "x"}, "the model's deck: 1 → 2; to run"),
    ],
)
def test_another_study_is_refused_with_what_differs(tmp_path, changes, said):
    with Store(tmp_path, study_settings()):
        pass
    with pytest.raises(StoreError, match=said) as caught, Store(tmp_path, study_settings(**changes)):
        pass
    assert "\n" not in str(caught.value)
    with Store(tmp_path, study_settings()):
        assert read_settings(tmp_path) == study_settings()


def test_a_study_goes_on_under_the_version_that_began_it_where_the_digits_are_the_same(tmp_path):
    assert version_there(tmp_path / "new") == __version__
    for began, goes_on in (
        ("0.1.0", "0.1.0"),
        ("0.2.0", "0.2.0"),
        ("0.0.9", __version__),
        (__version__, __version__),
    ):
        with Store(tmp_path / began, replace(study_settings(), calstudy=began)):
            assert version_there(tmp_path / began) == goes_on


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"plan": 1}', "null", '{"target": [1]}'])
def test_damaged_settings_are_refused(tmp_path, content):
    (tmp_path / "study.json").write_text(content)
    with pytest.raises(StoreError, match=r"study\.json is damaged"):
        read_settings(tmp_path)
    with pytest.raises(StoreError, match=r"study\.json is damaged"), Store(tmp_path, study_settings()):
        pass


def test_settings_with_an_unknown_key_are_refused(tmp_path):
    with Store(tmp_path, study_settings()):
        pass
    data = json.loads((tmp_path / "study.json").read_text())
    (tmp_path / "study.json").write_text(json.dumps(data | {"colour": "blue"}))
    with pytest.raises(StoreError, match="colour"):
        read_settings(tmp_path)


@pytest.mark.parametrize("name", ["absent", "empty", "a file"])
def test_what_is_no_study_is_said_to_be_none(tmp_path, name):
    (tmp_path / "empty").mkdir()
    (tmp_path / "a file").write_text("no study")
    with pytest.raises(StoreError, match="is no study"):
        read_settings(tmp_path / name)


# ---- one process at a time -----------------------------------------------------------------------


def test_a_second_store_is_refused_and_the_first_named(store):
    with (
        pytest.raises(StoreError, match=f"in use by process {os.getpid()} on "),
        Store(store.directory, study_settings()),
    ):
        pass
    store.record(an_evaluation())
    assert len(store.journal(3)) == 1


def test_a_closed_store_can_be_opened_again(tmp_path):
    for _ in range(2):
        with Store(tmp_path, study_settings()) as store:
            store.record(an_evaluation())
    assert len(Store(tmp_path, study_settings()).journal(3)) == 2


# ---- the directory -------------------------------------------------------------------------------


@pytest.mark.parametrize("place", ["file", "file/study", "study"])
def test_a_directory_that_cannot_be_written_is_a_setup_error(tmp_path, place):
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "journal").write_text("in the way")
    with pytest.raises(SetupError, match="choose another --study"), Store(tmp_path / place, study_settings()):
        pass


def test_a_store_that_failed_to_open_holds_no_lock(tmp_path):
    (tmp_path / "journal").write_text("in the way")
    with pytest.raises(SetupError), Store(tmp_path, study_settings()):
        pass
    (tmp_path / "journal").unlink()
    with Store(tmp_path, study_settings()) as store:
        store.record(an_evaluation())


def test_a_table_that_cannot_be_written_is_a_setup_error(store):
    store.record(an_evaluation())
    path = store.directory / "evaluations" / "row-03.parquet"
    path.mkdir()
    with pytest.raises(SetupError, match=r"row-03\.parquet: cannot be written"):
        store.finish(3, {"outcome": "ok"}, [an_evaluation()], [])
    assert store.finished_rows() == set()
    assert len(store.journal(3)) == 1

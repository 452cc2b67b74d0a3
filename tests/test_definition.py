"""The file of ``calstudy calibrate``: what it says is computed, and each mistake is refused by its line."""

import json
import re
import tomllib
from pathlib import Path

import pytest

from calstudy.errors import InputError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.plan_file import load_plan
from calstudy.study.definition import example, read_definition
from calstudy.study.run.definition import settings_of
from calstudy.study.settings import StudySettings, changes
from calstudy.tomlfile import key_lines

PLAN = load_plan()
ANGLE = "angle_of_repose_deg = { value = 22.0, tolerance = 2.0 }"


@pytest.fixture
def written(tmp_path):
    """Write the example with some lines changed; returns its path."""

    def write(*changes, name="case.toml"):
        text = example()
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def line_of(path, start):
    return next(k for k, line in enumerate(path.read_text().splitlines(), 1) if line.startswith(start))


# ---- what it says ----------------------------------------------------------------------------------


def test_the_example_is_the_papers_glass_beads(written):
    found = read_definition(written())
    task = found.task
    assert task.cost.target.values == {ANGLE_OF_REPOSE: 22.0, BULK_DENSITY: 1500.0}
    assert found.models[0].model.hash == load_model(PLAN.fixed, "soft").hash
    intervals = {p.name: (p.lower, p.upper) for p in PLAN.parameters}
    for name, low, high in zip(task.space.box.names, task.space.box.lower, task.space.box.upper, strict=True):
        assert (low, high) == intervals[name]
    constants = {p.name: p.constant for p in task.space.parameters if p.constant is not None}
    assert constants == {p.name: p.constant for p in PLAN.parameters if p.name in constants}
    assert task.cost.particles == (PLAN.fixed.particles,)
    assert set(task.noise) == {ANGLE_OF_REPOSE, BULK_DENSITY}  # known for the shipped model


def test_every_key_of_the_example_has_its_line():
    lines = example().splitlines()
    found = key_lines(example())
    for keys, number in found.items():
        assert str(keys[-1] if not isinstance(keys[-1], int) else keys[-2]) in lines[number - 1]
    flat = tomllib.loads(example())
    assert {("models", 0, "fixed", name) for name in flat["models"][0]["fixed"]} <= set(found)
    assert {("targets", name) for name in flat["targets"]} <= set(found)


def test_the_order_of_the_lines_changes_nothing(written, tmp_path):
    text = example()
    dens = next(line for line in text.splitlines(keepends=True) if line.startswith("DENS"))
    path = tmp_path / "case.toml"
    path.write_text(
        text.replace(dens, "").replace("[parameters]\n", "[parameters]\n").replace("YM = ", dens + "YM = ")
    )
    assert read_definition(path).hash == read_definition(written()).hash
    assert read_definition(path).task.space == read_definition(written()).task.space


@pytest.mark.parametrize(
    "change",
    [
        ("WRL = 0.1", "WRL = 1.0"),
        ("DENS = [2400.0, 2600.0]", "DENS = [2400.0, 2601.0]"),
        ("MU_PW = 0.2", "MU_PW = 0.21"),
        ("tolerance = 2.0", "tolerance = 3.0"),
        ("restitution_pp = 0.89", "restitution_pp = 0.9"),
        ('fidelity = "soft"', 'fidelity = "fast"'),
        ("# samples_per_parameter = 3", "samples_per_parameter = 3"),
        ("seed = 1 ", 'constraints = ["MU_PP >= MU_PW"]\nseed = 1 '),
        ("seed = 1 ", "together = 3\nseed = 1 "),
    ],
)
def test_what_decides_the_result_is_part_of_the_identity(written, change):
    before = read_definition(written()).hash
    assert read_definition(written(change)).hash != before


TWO = (
    'fidelity = "soft"',
    'fidelity = "tiny"\nlabel = "big"\n[[models]]\nname = "angle_of_repose"\n'
    'label = "small"\nfidelity = "coarse"',
)
TWO_TARGETS = (
    ("angle_of_repose_deg = {", "big_angle_of_repose_deg = {"),
    ("bulk_density = { value", "small_bulk_density = { value"),
)


def test_two_models_are_told_apart_by_their_labels(written):
    found = read_definition(written(TWO, *TWO_TARGETS))
    assert [chosen.prefix for chosen in found.models] == ["big_", "small_"]
    assert found.task.cost.responses == ("big_angle_of_repose_deg", "small_bulk_density")
    assert len(found.task.cost.particles) == 2
    assert found.task.mode.kriging.divisors == {"big_bulk_density": "DENS", "small_bulk_density": "DENS"}
    assert set(found.case.models) == {chosen.model.hash for chosen in found.models}


def test_a_budget_of_dem_runs_is_shared_by_the_models(written):
    budget = ("# budget = 6 ", "budget = 7 ")
    for models, each, confirm in (((), 7, 3), ((TWO, *TWO_TARGETS), 3, 1)):
        task = read_definition(written(*models, budget)).task
        assert (task.most, task.confirm) == (each, confirm)
        assert task.mode.second_optimisation.budget == each - confirm


@pytest.mark.parametrize("mode", ["robust", "paper"])
def test_runs_go_together_as_the_file_says_and_else_one_by_one(written, mode):
    by = (('mode = "robust"', f'mode = "{mode}"'), ("# samples_per_parameter", "samples_per_parameter"))
    alone, one, three = (
        read_definition(written(*by, ("seed = 1 ", f"{line}seed = 1 ")))
        for line in ("", "together = 1\n", "together = 3\n")
    )
    assert [found.task.mode.second_optimisation.together for found in (alone, one, three)] == [1, 1, 3]
    assert alone.hash == one.hash != three.hash
    with pytest.raises(InputError, match=r"together is 0; give a positive whole number"):
        read_definition(written(("seed = 1 ", "together = 0\nseed = 1 ")))


def test_runs_do_not_go_together_where_each_is_chosen_by_all_before_it(written):
    cheap = ('fidelity = "soft"', 'fidelity = "full"\ncheap = "soft"')
    with pytest.raises(InputError, match=r"line 5: with a cheap fidelity .* leave out together"):
        read_definition(written(cheap, ("seed = 1 ", "together = 3\nseed = 1 ")))


def test_what_confirms_is_as_the_file_says_and_else_four_or_half_of_a_budget(written):
    def task(*changes, **options):
        return read_definition(written(*changes), **options).task

    assert (task().confirm, task().most) == (4, None)
    assert task(confirm=0).confirm == 0, "a study from before there was such a thing goes on without"
    asked = ("# budget = 6 ", "confirm = 2 ")
    assert task(asked).confirm == task(asked, confirm=0).confirm == 2
    assert task(("# budget = 6 ", "confirm = 0 ")).confirm == 0
    assert task(("# budget = 6 ", "budget = 1 ")).confirm == 0
    for wrong in ("confirm = -1 ", "confirm = 2.5 "):
        with pytest.raises(InputError, match="confirm is"):
            task(("# budget = 6 ", wrong))
    with pytest.raises(InputError, match="a budget of 6 leaves nothing beside the 6 run"):
        task(("# budget = 6 ", "budget = 6 \nconfirm = 6 "))


OWN = """
script = "in.cell"
expected_seconds = 60
[parameters]
DENS = "kg/m3"
MU_PP = "-"
SPEED = "m/s"
[particles]
radius = 0.002
poissons_ratio = 0.3
density = "DENS"
youngs_modulus = 5e6
[responses.torque]
unit = "N m"
log = "torque"
"""
OWN_TOO = (
    ('name = "angle_of_repose"', '[[models]]\nname = "cell"\n[[models]]\nname = "angle_of_repose"'),
    ("[parameters]", "[parameters]\nSPEED = 0.1"),
    ("[targets]", "[targets]\ntorque = 3.0"),
)


@pytest.fixture
def with_cell(written, tmp_path):
    """Write the example with a model of one's own beside the shipped one; reads it."""

    def read(*changes, own=()):
        text = OWN
        for old, new in own:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        folder = tmp_path / "models" / "cell"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "in.cell").write_text(
            "run ${DENS} ${MU_PP} ${SPEED} ${stop} ${sum_of_squares} ${noise_torque} ${seed}\n"
        )
        (folder / "model.toml").write_text(text)
        path = written(("[[models]]\nname", "name"), *OWN_TOO, *changes)
        return read_definition(path, [tmp_path / "models"])

    return read


def test_a_folder_s_fidelity_and_fixed_numbers_are_chosen_in_the_file(with_cell):
    own = [
        ("[particles]", "[fixed]\nstop = 5\n[fidelity.cheap]\n[fidelity.expensive]\nstop = 6\n[particles]")
    ]

    def fixed(*lines):
        section = "\n".join(('name = "cell"', *lines, "[[models]]\n"))
        chosen = with_cell(('name = "cell"\n[[models]]\n', section), own=own).models[0]
        return chosen.fidelity, chosen.model.fixed

    assert fixed() == ("cheap", {"stop": 5})
    assert fixed('fidelity = "expensive"') == ("expensive", {"stop": 6})
    assert fixed('fidelity = "expensive"', "[models.fixed]", "stop = 7") == ("expensive", {"stop": 7})
    with pytest.raises(InputError, match=r"line 17: fidelity expansive is unknown to the model cell"):
        fixed('fidelity = "expansive"')
    with pytest.raises(InputError, match=r"line 18: sopt is not among what the model holds fixed"):
        fixed("[models.fixed]", "sopt = 7")


@pytest.mark.parametrize("place", [".", "liggghts_models"])
def test_a_model_is_found_beside_the_file_wherever_one_works(with_cell, tmp_path, monkeypatch, place):
    there = with_cell()
    if place != ".":
        (tmp_path / place).mkdir()
    (tmp_path / "models" / "cell").rename(tmp_path / place / "cell")
    monkeypatch.chdir("/")
    assert read_definition(there.path).hash == there.hash


def test_a_model_in_the_working_directory_is_not_taken_for_one_beside_the_file(
    with_cell, tmp_path, monkeypatch
):
    there = with_cell()
    (tmp_path / "elsewhere" / "liggghts_models").mkdir(parents=True)
    (tmp_path / "models" / "cell").rename(tmp_path / "elsewhere" / "liggghts_models" / "cell")
    monkeypatch.chdir(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=r"no model cell in .*--models DIR"):
        read_definition(there.path)


def test_noise_that_is_known_is_taken_though_that_of_another_response_is_not(with_cell):
    assert set(with_cell().task.noise) == {ANGLE_OF_REPOSE, BULK_DENSITY}
    given = with_cell(("torque = 3.0", "torque = { value = 3.0, noise = 0.1 }")).task.noise
    assert given["torque"] == 0.1 and len(given) == 3


def test_one_parameter_in_two_units_is_refused(with_cell):
    says = r"line \d+: DENS is in g/cm3 for cell and in kg/m3 for angle_of_repose; give both models one unit"
    with pytest.raises(InputError, match=says):
        with_cell(own=[('DENS = "kg/m3"', 'DENS = "g/cm3"')])


@pytest.mark.parametrize("name", ["stop", "sum_of_squares", "seed", "noise_torque"])
def test_a_parameter_that_would_be_a_second_column_is_refused(with_cell, name):
    with pytest.raises(
        InputError, match=rf"line \d+: {name} makes a second column .*{name} of the tables; call"
    ):
        with_cell(("SPEED = 0.1", f"{name} = 0.1"), own=[("SPEED", name)])


@pytest.mark.parametrize("name", ["kind", "origin", "stop", "cpu_time"])
def test_a_response_that_would_be_a_second_column_is_refused(with_cell, name):
    with pytest.raises(InputError, match=rf"{name} makes a second column .*{name} of the tables; call"):
        with_cell(("torque = 3.0", f"{name} = 3.0"), own=[("[responses.torque]", f"[responses.{name}]")])


# ---- targets ---------------------------------------------------------------------------------------


def both(angle, density="bulk_density = { values = [1490, 1505, 1502] }"):
    return (ANGLE, f"{angle}\n{density}"), ("bulk_density = { value = 1500.0, tolerance = 15.0 }", "")


def test_repeats_are_their_mean_and_its_error(written):
    found = read_definition(written(*both("angle_of_repose_deg = { value = 22.0667, sd = 0.493 }"))).task.cost
    assert found.target.values[BULK_DENSITY] == pytest.approx(1499.0)
    assert found.target.sd == pytest.approx({ANGLE_OF_REPOSE: 0.493, BULK_DENSITY: 7.937 / 3**0.5}, rel=1e-3)
    assert "bulk_density = 1499 ± 4.6 kg/m3" in found.target.origin


def test_a_study_keeps_errors_scales_and_what_is_minimised(written):
    lines = both(
        "angle_of_repose_deg = { minimise = true, scale = 2, weight = 3 }",
        "bulk_density = { value = 1500, sd = 9 }",
    )
    settings = settings_of(read_definition(written(*lines)), "engine")
    again = StudySettings.of_content(json.loads(json.dumps(settings.content)))
    assert again == settings and again.id == settings.id
    assert again.target.minimised == (ANGLE_OF_REPOSE,) and again.target.sd == {BULK_DENSITY: 9.0}
    heavier = settings_of(read_definition(written(*lines, ("weight = 3", "weight = 4"))), "engine")
    assert heavier.id != settings.id
    assert changes(settings.content, heavier.content) == ["the weight of angle_of_repose_deg: 3 → 4"]


def test_targets_without_error_keep_the_identity_from_before_there_was_one(written):
    settings = settings_of(read_definition(written()), "engine")
    assert set(settings.content["target"]) == {"values", "kind", "origin", "truth"}


# ---- what is refused ---------------------------------------------------------------------------------

REFUSALS = {
    "no TOML": (("WRL = 0.1", "WRL = ?"), "WRL", "is not TOML .*correct the line"),
    "unknown key": (("WRL = 0.1", "WLR = 0.1"), "WLR", "key WLR is unknown; did you mean WRL"),
    "WRL is no number": (("WRL = 0.1", 'WRL = "much"'), "WRL", "WRL is 'much'; give a number"),
    "WRL is a truth": (("WRL = 0.1", "WRL = true"), "WRL", "WRL is True; give a number"),
    "WRL is not finite": (("WRL = 0.1", "WRL = nan"), "WRL", "give a finite number"),
    "WRL below zero": (("WRL = 0.1", "WRL = -0.5"), "WRL", "must not be negative"),
    "seed is broken": (("seed = 1 ", "seed = 1.5 "), "seed", "seed is 1.5; give a whole number"),
    "seed below zero": (("seed = 1 ", "seed = -1 "), "seed", "give 0 to"),
    "density in g/cm3": (
        ("DENS = [2400.0, 2600.0]", "DENS = [2.4, 2.6]"),
        "DENS",
        "like g/cm3: write 2400, or ins",
    ),
    "friction in degrees": (("MU_PP = [0.1, 0.3]", "MU_PP = [0.1, 17]"), "MU_PP", "in degrees: write 0.3057"),
    "modulus in GPa": (("YM = [4.175e8, 6.5e8]", "YM = 5"), "YM", "it looks like GPa: write 5e.09"),
    "modulus in MPa": (
        ("YM = [4.175e8, 6.5e8]", "YM = [417, 6.5e8]"),
        "YM",
        "it looks like MPa: write 4.17e.08",
    ),
    "angle in radians": (
        (ANGLE, ANGLE.replace("22.0", "0.384")),
        "angle_of",
        "like radians: write 22, or insist",
    ),
    "angle beyond upright": (
        (ANGLE, ANGLE.replace("22.0", "91.0")),
        "angle_of",
        "plausible range of 2 to 90",
    ),
    "angle without end": (
        (ANGLE, ANGLE.replace("22.0", "1e308")),
        "angle_of",
        "is 1e.308 deg, outside the plausible",
    ),
    "bulk density in g/cm3": (("value = 1500.0", "value = 1.5"), "bulk_d", "it looks like g/cm3: write 1500"),
    "tolerance as large as its target": (
        (ANGLE, ANGLE.replace("= 2.0", "= 22")),
        "angle_of",
        "as large as its t",
    ),
    "noise as large as its target": (
        (ANGLE, ANGLE.replace("tolerance = 2.0", "noise = 22")),
        "angle_of",
        "noise .* as",
    ),
    "WRL in percent": (("WRL = 0.1", "WRL = 50"), "WRL", "range of 0 to 1; it looks like percent: write 0.5"),
    "samples in thousands": (
        ("# samples_per_parameter = 3", "samples_per_parameter = 3000"),
        "samples_p",
        "of 1 to 100",
    ),
    "budget in millions": (
        ("# budget = 6", "budget = 1000000"),
        "budget",
        "outside the plausible range of 1 to 10000",
    ),
    "gravity in mm/s2": (
        ("poissons_ratio = 0.22", "gravity = 9810"),
        "gravity",
        "it looks like mm/s2: write 9.81",
    ),
    "decimal comma": (("MU_PW = 0.2", "MU_PW = 0,2"), "MU_PW", "write 0.2 with a decimal point"),
    "decimal commas": (("MU_PP = [0.1, 0.3]", "MU_PP = [0,1, 0,3]"), "MU_PP", "has 4 ends; .* decimal point"),
    "decimal comma in quotes": (("MU_PW = 0.2", 'MU_PW = "0,2"'), "MU_PW", "decimal comma; write 0.2"),
    "unknown mode": (('mode = "robust"', 'mode = "wild"'), "mode", "choose one of paper, robust"),
    "mode without samples": (('mode = "robust"', 'mode = "paper"'), "mode", "needs samples_per_parameter"),
    "no samples": (
        ("# samples_per_parameter = 3", "samples_per_parameter = 0"),
        "samples_per",
        "positive whole",
    ),
    "too few samples": (
        ('mode = "robust"', 'mode = "paper"\nsamples_per_parameter = 1'),
        "samples_per",
        "4 sample.* are too few: Kriging of 4 .* needs 6",
    ),
    "no budget": (("# budget = 6", "budget = 0"), "budget", "positive whole number"),
    "unknown model": (
        ('name = "angle_of_repose"', 'name = "shear"'),
        "name",
        "no model shear .*--models DIR",
    ),
    "model by a path": (('name = "angle_of_repose"', 'name = "/etc/shear"'), "name", "not a path"),
    "model by a way up": (('name = "angle_of_repose"', 'name = ".."'), "name", "not a path such as '..'"),
    "unknown fidelity": (('fidelity = "soft"', 'fidelity = "rough"'), "fidelity", "choose one of full, fast"),
    "unknown variant": (('variant = "ring"', 'variant = "square"'), "variant", "choose one of ring"),
    "fixed is no physics": (
        ("poissons_ratio = 0.22", "poissons_ratio = 0.5"),
        "poissons_ratio",
        r"\[0; 0.5\)",
    ),
    "beads of another size": (
        ("restitution_pp = 0.89", "particle_radius = 0.001"),
        "particle_radius",
        r"\[models.material\] has the beads\' size",
    ),
    "fixed is unknown": (("restitution_pp", "restitution"), "restitution =", "did you mean restitution_p"),
    "unknown parameter": (("MU_PP =", "MU_P ="), "MU_P ", "key MU_P is unknown; did you mean MU_P[PW]"),
    "missing parameter": (
        ("RF_PW = 0.01", "# none"),
        "[parameters]",
        "lacks RF_PW, which angle_of_repose takes",
    ),
    "interval upside down": (
        ("[0.1, 0.3]", "[0.3, 0.1]"),
        "MU_PP",
        "goes from 0.3 to 0.1; write the smaller",
    ),
    "interval without width": (("[0.1, 0.3]", "[0.3, 0.3]"), "MU_PP", "write the smaller one first"),
    "interval of three ends": (("[0.1, 0.3]", "[0.1, 0.2, 0.3]"), "MU_PP", "has 3 ends; write"),
    "interval of a word": (("[0.1, 0.3]", '[0.1, "b"]'), "MU_PP", "MU_PP is 'b'; give a number"),
    "parameter is a word": (
        ("MU_PW = 0.2", 'MU_PW = "low"'),
        "MU_PW",
        "'low'; give an interval .* or a number",
    ),
    "negative friction": (("[0.1, 0.3]", "[-0.1, 0.3]"), "MU_PP", "cannot be negative"),
    "density of zero": (("DENS = [2400.0,", "DENS = [0.0,"), "DENS", "must be positive"),
    "too soft for LIGGGHTS": (("[4.175e8,", "[3.9e8,"), "YM", "LIGGGHTS needs 5e.06: raise it"),
    "no target of a response": (
        (ANGLE, "torque = 3.0"),
        "torque",
        "no model gives a response torque; there are",
    ),
    "target of zero": (
        (ANGLE, ANGLE.replace("22.0", "0.0")),
        "angle_of",
        "is 0, and Eq. 9 divides by it; write angle_of_repose_deg = { value = 0, scale = ",
    ),
    "constraint is no list": (
        ("seed = 1 ", 'constraints = "MU_PP >= 0.2"\nseed = 1 '),
        "constraints",
        "give a list",
    ),
    "constraints among the parameters": (
        ("MU_PP = [0.1, 0.3] ", 'constraints = ["MU_PP >= MU_PW"]\nMU_PP = [0.1, 0.3] '),
        "constraints",
        "stand before the first section of the file; move them",
    ),
    "constraint is no text": (("seed = 1 ", "constraints = [1]\nseed = 1 "), "constraints", "give a text"),
    "constraint of another parameter": (
        ("seed = 1 ", 'constraints = ["MU_PQ >= 0.2"]\nseed = 1 '),
        "constraints",
        "MU_PQ is not a parameter; did you mean",
    ),
    "constraint in mode paper": (
        ('mode = "robust"', 'constraints = ["MU_PP >= 0.2"]\nsamples_per_parameter = 3\nmode = "paper"'),
        "constraints",
        "mode paper knows no constraints, only bounds; take mode robust",
    ),
    "error of zero": ((ANGLE, "angle_of_repose_deg = { value = 22, sd = 0 }"), "angle_of", "leave it out"),
    "error as large as its target": (
        (ANGLE, "angle_of_repose_deg = { value = 22, sd = 22 }"),
        "bulk_density",
        "angle_of_repose_deg has an error and bulk_density has none",
    ),
    "scale of zero": ((ANGLE, "angle_of_repose_deg = { value = 22, scale = 0 }"), "angle_of", "be positive"),
    "negative weight": (
        (ANGLE, "angle_of_repose_deg = { value = 22, weight = -1 }"),
        "angle_of",
        "remove the target to leave it out",
    ),
    "error and scale": (
        (ANGLE, "angle_of_repose_deg = { value = 22, sd = 1, scale = 2 }"),
        "angle_of",
        "either weighs it; remove one",
    ),
    "one repeat": ((ANGLE, "angle_of_repose_deg = { values = [22] }"), "angle_of", "give two or more"),
    "repeats of a word": (
        (ANGLE, 'angle_of_repose_deg = { values = [22, "b"] }'),
        "angle_of",
        "values is 'b'; give a number",
    ),
    "equal repeats": ((ANGLE, "angle_of_repose_deg = { values = [22, 22] }"), "angle_of", "tells no error"),
    "repeats and a value": (
        (ANGLE, "angle_of_repose_deg = { value = 22, values = [21, 23] }"),
        "angle_of",
        "of which the mean and its error are taken; remove",
    ),
    "minimised without a scale": (
        (ANGLE, "angle_of_repose_deg = { minimise = true }"),
        "angle_of",
        "give its scale: the change that counts",
    ),
    "minimised at a word": (
        (ANGLE, 'angle_of_repose_deg = { minimise = "yes", scale = 1 }'),
        "angle_of",
        "minimise is 'yes'; give true or false",
    ),
    "target is a word": ((ANGLE, 'angle_of_repose_deg = "flat"'), "angle_of", "is 'flat'; give a number"),
    "target without value": (
        (ANGLE, "angle_of_repose_deg = { tolerance = 1.0 }"),
        "angle_of",
        "lacks value; add",
    ),
    "negative tolerance": (
        (ANGLE, ANGLE.replace("= 2.0", "= -2.0")),
        "angle_of",
        "tolerance .* give 0 or more",
    ),
    "noise of zero": (
        (ANGLE, ANGLE.replace("tolerance = 2.0", "noise = 0.0")),
        "angle_of",
        "it must be positive",
    ),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_a_mistake_is_refused_with_its_line_and_the_remedy(written, case):
    change, start, says = REFUSALS[case]
    path = written(change)
    with pytest.raises(InputError) as refused:
        read_definition(path)
    message = str(refused.value)
    assert message.startswith(f"{path}, line {line_of(path, start)}: "), message
    assert re.search(says, message) and "\n" not in message


def test_nothing_calibrated_that_moves_the_time_step_is_refused_while_it_has_weight(written):
    fixed = (("DENS = [2400.0, 2600.0]", "DENS = 2500.0"), ("YM = [4.175e8, 6.5e8]", "YM = 5.06e8"))
    path = written(*fixed)
    says = (
        rf"line {line_of(path, 'WRL')}: WRL is 0.1 but no calibrated parameter moves .*; calibrate DENS or YM"
    )
    with pytest.raises(InputError, match=says):
        read_definition(path)
    assert read_definition(written(*fixed, ("WRL = 0.1", "WRL = 0"))).task.cost.WRL == 0


def test_nothing_calibrated_at_all_is_refused(written):
    values = re.findall(r"^(\w+ = (\[)([\d.e]+),.*?\])", example(), re.MULTILINE)
    path = written(*((whole, whole.split("=")[0] + f"= {low}") for whole, _, low in values))
    with pytest.raises(InputError, match=r"no parameter is calibrated; give at least one an interval"):
        read_definition(path)


def test_responses_of_one_name_are_refused_without_labels(written):
    path = written((TWO[0], TWO[1].replace('label = "big"\n', "").replace('label = "small"\n', "")))
    with pytest.raises(InputError, match=r"both give angle_of_repose_deg; tell them apart with label"):
        read_definition(path)


def test_a_model_twice_is_refused(written):
    path = written((TWO[0], TWO[1].replace("coarse", "tiny")), ('variant = "ring"', ""))
    with pytest.raises(InputError, match=r"the same model stands here twice"):
        read_definition(path)


def test_a_budget_that_no_parameter_set_fits_into_is_refused(written):
    with pytest.raises(InputError, match=r"a budget of 1 is less than the 2 DEM runs of one parameter set"):
        read_definition(written(TWO, *TWO_TARGETS, ("# budget = 6 ", "budget = 1 ")))


@pytest.mark.parametrize("missing", ["models", "targets", "parameters"])
def test_a_section_that_is_missing_is_refused(written, missing, tmp_path):
    parts = re.split(r"(?m)^(?=\[)", example())
    kept = [part for part in parts if not part.lstrip("[").startswith(missing)]
    path = tmp_path / "case.toml"
    path.write_text("".join(kept))
    with pytest.raises(InputError, match=r"case\.toml"):
        read_definition(path)


def test_a_file_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"cannot be read \(No such file or directory\); check the name"):
        read_definition(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes(b"mode = '\xe9'")
    with pytest.raises(InputError, match=r"is not UTF-8 text"):
        read_definition(tmp_path / "latin.toml")


def test_the_shipped_file_is_the_one_that_is_written():
    assert example() == (Path(__file__).parent.parent / "plans" / "glass_beads.toml").read_text()


def test_who_insists_gets_implausible_values(written):
    changes = (("DENS = [2400.0, 2600.0]", "DENS = [2.4, 2.6]"), (ANGLE, ANGLE.replace("22.0", "91.0")))
    definition = read_definition(written(*changes, ("WRL = 0.1", "WRL = 50")), insist=True)
    assert definition.task.space.box.lower[0] == 2.4 and definition.task.cost.WRL == 50
    assert definition.task.cost.target.values["angle_of_repose_deg"] == 91.0

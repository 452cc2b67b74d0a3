"""What is known of an input script before it runs: what calibrators brought, and what they are told."""

import pytest

from calstudy.models.trial.script import Script, commands_of, objections

SOUND = """
# MU is the friction
include params.in
fix m all property/global coefficientFriction peratomtypepair 1 ${MU}
variable half equal 0.5*v_DENS
print "torque = ${half}"
"""


def script(text, include="params.in", files=None, names=("MU", "DENS"), has_end=True):
    contents = {"in.shear": text.encode()} | {n: t.encode() for n, t in (files or {}).items()}
    if include:
        contents.setdefault(include, b"")
    return Script("in.shear", contents, include, names, has_end)


def told(*given, **how):
    return [found.text for found in objections(script(*given, **how))]


def test_a_sound_script_is_not_objected_to():
    assert told(SOUND) == []
    assert told(SOUND.replace("include params.in", "variable MU index 0.1"), include=None) == []


def test_commands_have_their_line_and_no_comments():
    text = 'run 10 # ten\n\nprint "# no comment" &\n  file out.txt\n# alone\nrun 20'
    assert [(c.line, c.words) for c in commands_of("in", text)] == [
        (1, ("run", "10")),
        (3, ("print", '"#', "no", 'comment"', "file", "out.txt")),
        (6, ("run", "20")),
    ]


@pytest.mark.parametrize(
    ("change", "how", "says"),
    [
        (
            ("include params.in", "include /home/me/case/params.in"),
            {},
            "in.shear, line 3: includes /home/me/case/params.in, while the parameters are written into the "
            "run's own params.in; write 'include params.in'",
        ),
        (
            ("include params.in", ""),
            {},
            "in.shear never includes params.in; write 'include params.in' at",
        ),
        (
            ("include params.in", "variable MU equal 0.5"),
            {"include": None},
            "in.shear, line 3: sets MU as a variable of style equal, which the command line cannot; write "
            "'variable MU index 0.5'",
        ),
        (
            ("include params.in", "include params.in\nvariable MU equal 0.5"),
            {},
            "in.shear, line 4: sets MU again after params.in, so the parameter's value is lost; remove",
        ),
        (
            ("${MU}", "0.5"),
            {},
            "in.shear never uses MU: it has neither ${MU} nor v_MU outside comments, so the parameter would "
            "change nothing; use it, or correct the name",
        ),
        (("${MU}", "{{ MU }}"), {}, "in.shear, line 4: {{ MU }} is a template's placeholder"),
        (
            ("print", "quit\nprint"),
            {"has_end": False},
            "in.shear, line 6: LIGGGHTS ends 'quit' with exit code 1, as it ends a failure; remove it",
        ),
    ],
)
def test_what_cannot_work_is_told_with_its_place_and_remedy(change, how, says):
    assert change[0] in SOUND
    found = told(SOUND.replace(*change), **how)
    assert found
    assert found[0].startswith(says)


def test_a_parameter_of_an_included_file_counts_as_used():
    assert told("include params.in\ninclude contact.in", files={"contact.in": "fix a ${MU} ${DENS}"}) == []


def test_a_parameter_that_another_file_takes_counts_as_used():
    assert told("include params.in\nshell python mesh.py", files={"mesh.py": "read('MU', 'DENS')"}) == []


def test_a_file_whose_name_a_variable_holds_may_be_any():
    assert told("include ${case}.in", names=("MU",)) == []


def test_a_file_that_includes_itself_ends():
    assert told("include params.in\ninclude in.shear\nprint ${MU}${DENS}") == []


def test_two_stages_may_include_the_parameters_twice():
    two = SOUND + "clear\n" + SOUND
    assert told(two) == []


def test_quit_is_no_harm_where_the_log_must_say_the_end():
    assert told(SOUND + "quit") == []


def test_names_are_words():
    assert told("include params.in\nprint ${MU_PP} ${DENS}")[0].startswith("in.shear never uses MU:")

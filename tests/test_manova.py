"""MANOVA: R's numbers, and the traps in which ranks get lost without a word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calstudy.analysis.statistics.manova import manova, terms_of
from calstudy.errors import InputError
from calstudy.plan import PARAMETERS

GOLDEN = Path(__file__).parent / "golden"
RESPONSES = ["AoR", "BD", "DTR"]
RTOL = 1e-9


@pytest.fixture(scope="module")
def case():
    """Factors and responses in raw units, as R was not given them and as a study has them."""
    frame = pd.read_csv(GOLDEN / "manova_case.csv")
    return frame[list(PARAMETERS)], frame[RESPONSES]


@pytest.fixture(scope="module")
def found(case):
    return manova(*case)


def golden(test):
    table = pd.read_csv(GOLDEN / "manova_R.csv")
    return table[table["test"] == test].set_index("term")


def test_the_terms_stand_in_rs_order():
    assert terms_of(PARAMETERS) == list(golden("Pillai").index)


def test_sequential_tests_are_rs_manova(found):
    for term, known in golden("Pillai").iterrows():
        test = found.sequential[term]
        assert (test.num_df, test.den_df) == (known["num_df"], known["den_df"])
        assert test.pillai == pytest.approx(known["stat"], rel=RTOL)
        assert test.f == pytest.approx(known["F"], rel=RTOL)
        assert test.p == pytest.approx(known["p"], rel=RTOL, abs=0)


@pytest.mark.parametrize("other", ["Wilks", "Hotelling-Lawley", "Roy"])
def test_all_of_rs_statistics_give_the_same_f(found, other):
    for term, known in golden(other).iterrows():
        assert found.sequential[term].f == pytest.approx(known["F"], rel=RTOL)


def test_tests_given_all_others_are_cars_type_iii(found):
    table = pd.read_csv(GOLDEN / "manova_R_car.csv")
    known = table[(table["type"] == "III") & (table["term"] != "(Intercept)")].set_index("term")["pillai"]
    assert set(known.index) == set(found.marginal)
    for term, pillai in known.items():
        assert found.marginal[term].pillai == pytest.approx(pillai, rel=RTOL)


def test_raw_units_lose_nothing(case, found):
    factors, responses = case
    scaled = manova(factors / factors.std(), 1e6 * responses - 5)
    assert not found.untested and not found.left_out and found.residual_df == 50
    for term, test in found.sequential.items():
        assert test.f == pytest.approx(scaled.sequential[term].f, rel=1e-8)


def test_the_order_matters_to_sequential_tests_alone(case, found):
    factors, responses = case
    turned = manova(factors[list(PARAMETERS[::-1])], responses)
    assert turned.sequential["MU_PW"].f != pytest.approx(found.sequential["MU_PW"].f, rel=0.01)
    for name in PARAMETERS:
        assert turned.marginal[name].f == pytest.approx(found.marginal[name].f, rel=1e-8)


@pytest.mark.slow
def test_permuted_responses_have_no_effect(case):
    factors, responses = case
    rng = np.random.default_rng(3)
    p = []
    for _ in range(8):
        shuffled = responses.iloc[rng.permutation(len(responses))].reset_index(drop=True)
        p += [test.p for test in manova(factors, shuffled).sequential.values()]
    assert 0.01 < np.mean(np.array(p) < 0.05) < 0.12


def test_an_effect_lies_in_its_interval(found):
    effect = found.sequential["DENS"].partial_eta_squared(found.n)
    assert effect.value == pytest.approx(found.sequential["DENS"].pillai)
    assert 0.99 < effect.low < effect.value < effect.high < 1


def test_one_response_that_is_left_is_a_reason_and_the_others_are_named(case):
    factors, responses = case
    constant = responses.assign(BD=1500.0, DTR=2e-5 + 1e-9 * factors["DENS"])
    found = manova(factors, constant)
    assert found.responses == ("AoR",) and not found.sequential and set(found.left_out) == {"BD", "DTR"}
    assert set(found.untested) == set(terms_of(PARAMETERS))
    assert found.untested["DENS"].startswith("AoR alone is left to test: BD is constant")


@pytest.mark.parametrize(
    ("change", "terms", "said"),
    [
        (lambda f, r: (f, r[["AoR"]]), (), r"1 response\(s\); give 2 or more"),
        (
            lambda f, r: (f, r.assign(BD=r["BD"].where(r["BD"].index != 2))),
            (),
            "BD has values that are not finite",
        ),
        (lambda f, r: (f.assign(YM=np.inf), r), (), "YM has values that are not finite"),
        (lambda f, r: (f.assign(YM=["low", "high"] * 36), r), (), "YM is not numeric; .* columns of 0 and 1"),
        (lambda f, r: (f.assign(YM=pd.Categorical([1, 2, 3] * 24)), r), (), "YM is not numeric"),
        (
            lambda f, r: (f, r),
            ("DENS", "C(YM)"),
            "the term 'C.YM.' asks for 'C.YM.', which",
        ),
        (lambda f, r: (f, r), ("DENS:WRL",), "the term 'DENS:WRL' asks for 'WRL'"),
    ],
)
def test_what_no_multivariate_test_of_numbers_can_be_made_of_is_one_clear_error(case, change, terms, said):
    with pytest.raises(InputError, match=said):
        manova(*change(*case), terms)


def test_a_factor_of_true_and_false_is_one_of_0_and_1(case):
    factors, responses = case
    is_high = factors["YM"] > factors["YM"].median()
    one, other = (manova(factors.assign(YM=is_high.astype(kind)), responses) for kind in (bool, float))
    assert one.sequential == other.sequential


# ---- what cannot be tested --------------------------------------------------------------------------


def test_a_constant_factor_is_named_and_the_others_are_tested(case, found):
    factors, responses = case
    without = manova(factors.assign(YM=4.175e8), responses)
    named = {term for term in terms_of(PARAMETERS) if "YM" in term.split(":")}
    assert set(without.untested) == named and all("YM constant" in r for r in without.untested.values())
    assert set(without.sequential) == set(found.sequential) - named and without.residual_df == 56


def test_an_aliased_term_is_named_with_what_makes_it_up(case):
    factors, responses = case
    aliased = factors.assign(RF_PW=0.3 * factors["RF_PP"] - factors["MU_PP"] / 100 + 0.02)
    found = manova(aliased, responses)
    assert "RF_PW" not in found.sequential
    assert found.untested["RF_PW"] == "aliased: a combination of MU_PP, RF_PP"
    assert set(found.sequential) | set(found.untested) == set(terms_of(PARAMETERS))


def test_a_response_that_is_fitted_exactly_is_named_and_left_out(case):
    factors, responses = case
    exact = responses.assign(DTR=2e-5 + 1e-9 * factors["DENS"] - 3e-14 * factors["YM"])
    found = manova(factors, exact)
    assert found.responses == ("AoR", "BD") and "fitted exactly" in found.left_out["DTR"]
    # What is left is the test of the two others, unharmed.
    two = manova(factors, responses[["AoR", "BD"]])
    assert found.sequential["DENS"].f == pytest.approx(two.sequential["DENS"].f, rel=1e-9)
    assert found.sequential["DENS"].num_df == 2


def test_a_response_that_repeats_others_is_named_and_left_out(case):
    factors, responses = case
    found = manova(factors, responses.assign(DTR=1e-6 * responses["AoR"] + 1e-9 * responses["BD"]))
    assert found.responses == ("AoR", "BD")
    assert found.left_out["DTR"] == "in its residuals a combination of AoR, BD"


def test_a_constant_response_is_named_and_left_out(case):
    factors, responses = case
    found = manova(factors, responses.assign(DTR=3e-5))
    assert found.responses == ("AoR", "BD") and found.left_out["DTR"] == "constant over these rows"


@pytest.mark.parametrize("n", [0, 1, 2, 12, 24])
def test_too_few_rows_test_nothing_and_say_so(case, n):
    factors, responses = case
    found = manova(factors.head(n), responses.head(n))
    assert not found.sequential and set(found.untested) == set(terms_of(PARAMETERS))
    assert all(found.untested.values())


def test_twelve_rows_allow_the_main_effects(case):
    factors, responses = case
    found = manova(factors.head(12), responses.head(12), PARAMETERS)
    assert set(found.sequential) == set(PARAMETERS) and found.residual_df == 5


@pytest.mark.parametrize("n", range(10, 18))
def test_few_residual_degrees_of_freedom_are_tested_as_any(case, n):
    """With six main effects and n = 13, statsmodels divides by zero for a statistic that is not asked for."""
    factors, responses = (frame[:n] for frame in case)
    test = manova(factors, responses, PARAMETERS).sequential["DENS"]
    assert (test.num_df, test.den_df) == (3, n - 9)
    trace = test.pillai
    assert test.f == pytest.approx(trace / (1.0 - trace) * test.den_df / test.num_df, rel=RTOL)
    assert 0.0 < test.p < 1.0


def test_factors_that_are_all_constant_test_nothing(case):
    factors, responses = case
    found = manova(factors * 0 + 5.0, responses)
    assert not found.sequential and all("constant over these 72 rows" in r for r in found.untested.values())


def test_all_responses_gone_leaves_a_reason(case):
    factors, _ = case
    flat = pd.DataFrame({name: np.ones(len(factors)) for name in RESPONSES})
    assert "no response is left" in manova(factors, flat).untested["DENS"]

"""What twenty people with DEM models of their own met, U1 to U22, and the tests that hold what is so now."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
HELD: dict[str, tuple[str, tuple[str, ...]]] = {
    "U1": (
        "old values and old results are found by the script's reading and a trial run before any sample",
        (
            "test_script::test_what_cannot_work_is_told_with_its_place_and_remedy",
            "test_trial::test_what_would_fail_late_or_silently_is_a_fault",
            "test_own_model::test_an_output_that_lies_in_the_folder_is_refused",
        ),
    ),
    "U2": (
        "a marker ends at a word's end, the last matching line counts, and the trial shows it",
        (
            "test_readers::test_a_marker_ends_at_a_word_s_end_and_its_last_number_counts",
            "test_trial::test_a_sound_model_shows_each_response_at_both_ends_and_where_it_was_read",
        ),
    ),
    "U3": (
        "beads are drawn with the dump's own radii",
        ("test_readers::test_beads_are_drawn_with_the_dump_s_own_radii",),
    ),
    "U4": (
        "launcher and ranks are part of the identity",
        (
            "test_ranks::test_ranks_are_part_of_the_identity_and_are_whole",
            "test_ranks::test_a_launcher_in_the_command_is_refused_since_its_ranks_would_be_in_no_identity",
            "test_reread::test_what_the_program_gets_is_part_of_what_makes_a_run",
        ),
    ),
    "U5": (
        "ranks are a key and an option, counted in cores, and bound to none",
        (
            "test_ranks::test_ranks_are_counted_against_the_cores",
            "test_ranks::test_ranks_of_the_command_line_take_the_place_of_the_model_s",
            "test_ranks::test_ranks_are_bound_to_no_core_by_either_launcher",
            "test_ranks::test_without_a_launcher_the_remedy_is_said",
            "test_ranks::test_real_liggghts_runs_on_two_ranks",
        ),
    ),
    "U6": (
        "a script that quits is told before any run, or its mark of the end decides",
        (
            "test_script::test_quit_is_no_harm_where_the_log_must_say_the_end",
            "test_own_model::test_a_run_that_quits_after_its_mark_counts",
        ),
    ),
    "U7": (
        "a script that moves its log is read on the screen, and so is the reason of its failure",
        (
            "test_own_model::test_a_log_that_the_script_moves_is_read_on_the_screen",
            "test_own_model::test_the_error_of_a_run_that_moved_its_log_is_found_on_the_screen",
        ),
    ),
    "U8": (
        "variables of style equal are told with the remedy, and adopt writes the changed copy",
        (
            "test_script::test_what_cannot_work_is_told_with_its_place_and_remedy",
            "test_adopt::test_numbers_become_variables_of_the_command_line_and_nothing_else_changes",
            "test_adopt::test_the_command_writes_a_folder_that_loads",
        ),
    ),
    "U9": (
        "placeholders are filled, and two stages work",
        (
            "test_links::test_a_template_is_filled_and_what_stands_there_is_not_handed_over_again",
            "test_links::test_what_a_template_cannot_be_is_said",
            "test_script::test_two_stages_may_include_the_parameters_twice",
        ),
    ),
    "U10": (
        "where all runs fail, search, reach and solution space keep away",
        (
            "test_success::test_the_optimum_does_not_propose_again_where_all_fail",
            "test_success::test_reach_and_solutions_leave_out_where_all_fail",
        ),
    ),
    "U11": (
        "a large folder is refused unread; files that are only read are linked, and hashed in chunks",
        (
            "test_own_model::test_a_folder_of_old_results_is_refused_before_it_is_read_and_a_run_can_do_without",
            "test_links::test_a_large_linked_file_takes_no_memory",
            "test_links::test_a_run_that_writes_what_it_links_is_refused",
        ),
    ),
    "U12": (
        "parameters may count, be logarithmic, listed, chosen by name, or follow from others",
        (
            "test_own_command::test_a_parameter_that_counts_is_whole_in_every_run",
            "test_kinds::test_a_calibration_of_all_kinds_runs_what_they_are_and_reports_it",
        ),
    ),
    "U13": (
        "targets of zero with a scale, negative ones, and objectives to be minimised",
        (
            "test_cost::test_a_target_that_is_zero_or_not_finite_is_refused",
            "test_cost::test_a_chosen_scale_stands_in_the_targets_place",
            "test_cost::test_a_negative_target_is_divided_by_its_size",
            "test_cost::test_an_objective_costs_nothing_below_its_value",
        ),
    ),
    "U14": (
        "a calibrated radius or Poisson's ratio enters the Rayleigh time-step",
        ("test_kinds::test_whatever_moves_the_rayleigh_time_step_enters_the_cost",),
    ),
    "U15": (
        "a wrong mark of the end costs one run, which is read anew after the correction",
        (
            "test_reread::test_a_wrong_mark_of_the_end_is_mended_without_a_run",
            "test_reread::test_a_corrected_reader_costs_no_run_that_is_kept",
            "test_reread::test_what_is_read_of_a_run_is_no_part_of_what_makes_it",
        ),
    ),
    "U16": (
        "another target, interval, budget, seed or number of samples costs no sample, nor does another name",
        (
            "test_stored::test_what_was_not_part_of_a_run_costs_no_sample",
            "test_stored::test_a_narrower_interval_takes_what_lies_inside_and_samples_the_rest",
            "test_reread::test_an_added_test_and_a_renamed_file_run_nothing_again",
        ),
    ),
    "U17": (
        "readers get the parameters, and any executable is one",
        (
            "test_command_reader::test_a_command_reads_what_it_prints_last",
            "test_command_reader::test_a_python_function_of_two_arguments_gets_the_parameters",
        ),
    ),
    "U18": (
        "LAMMPS, YADE, forks of LIGGGHTS and any command run",
        (
            "test_lammps::test_a_heap_by_lammps_has_the_angle_and_density_that_liggghts_gives",
            "test_yade::test_a_heap_by_yade_has_the_angle_and_density_that_liggghts_gives",
            "test_forks::test_a_study_by_a_fork_says_so_and_is_not_taken_for_liggghts",
            "test_own_command::test_it_is_tried_and_calibrated_like_any_other",
        ),
    ),
    "U19": (
        "a curve is one target",
        (
            "test_curves::test_a_curve_weighs_as_one_response",
            "test_curves::test_a_calibration_finds_the_parameters_of_a_curve",
        ),
    ),
    "U20": (
        "a photograph with its background is measured, or refused with the reason",
        (
            "test_photographs::test_a_photograph_gives_the_angle_of_its_exact_outline",
            "test_photographs::test_a_photograph_that_cannot_be_measured_is_refused",
            "test_photographs::test_measure_prints_what_a_calibration_takes",
        ),
    ),
    "U21": (
        "the optimum is confirmed with fresh seeds, and one that is contradicted is given up for another",
        (
            "test_two_fidelities::test_the_optimum_is_run_again_with_seeds_of_its_own_at_the_same_parameters",
            "test_two_fidelities::test_a_confirmation_that_contradicts_goes_on_to_another_point_within_the_budget",
        ),
    ),
    "U22": (
        "a refusal says which file changed in which lines, what stays, and what a new study costs",
        (
            "test_reread::test_a_refusal_names_the_lines_that_changed_and_what_a_new_study_costs",
            "test_reread::test_a_study_from_before_models_were_told_is_refused_as_it_was",
        ),
    ),
}
"""Of each line what is so now, and the tests that hold it as ``file::test``."""


@cache
def named_in(file: str) -> frozenset[str]:
    """Names of the tests of a file."""
    path = TESTS / f"{file}.py"
    nodes = ast.parse(path.read_text()).body if path.is_file() else []
    return frozenset(node.name for node in nodes if isinstance(node, ast.FunctionDef))


def missing(held: dict[str, tuple[str, tuple[str, ...]]]) -> list[str]:
    """Tests that a table names and that are not there."""
    named = [test for _, tests in held.values() for test in tests]
    return [test for test in named if test.split("::")[1] not in named_in(test.split("::")[0])]


def test_each_line_names_its_tests_and_they_are_there():
    assert list(HELD) == [f"U{k}" for k in range(1, 23)]
    assert missing(HELD) == []
    assert all(tests for _, tests in HELD.values())


@pytest.mark.parametrize("gone", ["test_users::test_that_vanished", "test_nowhere::test_of_it"])
def test_a_test_that_vanished_is_found(gone):
    assert missing({"U1": ("", (gone,))}) == [gone]

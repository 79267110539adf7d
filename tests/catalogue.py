"""The 96 bad inputs and events of the list of what must not go wrong, and for each the tests of
what a user sees.

{number: (what is bad, "file: tests or cases", ...)}; a test of `test_catalogue` finds each of them.
Where it says "no ...", jaxbody has no such message, for the reason given.
"""

BAD = "model/test_bad_models.py"
TRACED = "model/test_traced_numbers.py"
STATICS = "mechanics/test_statics.py"
MOTIONS = "model/inputs/test_motions.py"
SIMULATIONS = "motion/test_simulations.py"
CAUSES = "mechanics/test_failure_causes.py"
LOADS = "model/inputs/test_loads.py"
RECORDS = "records/test_records.py"
DIAGNOSES = "fitting/experiments/test_diagnoses.py"
SENSORS = "sensors/test_sensors.py"
FITS = "fitting/test_identification.py"
LOSSES = "fitting/test_losses.py"
FILES = "files/test_model_files.py"
DOCUMENTS = "files/test_documents.py"

CATALOGUE: dict[int, tuple[str, ...]] = {
    1: ("unknown body in a spring", f"{BAD}: 1 unknown body, 1 unknown parent, 1 joint of no body"),
    2: (
        "a name twice",
        f"{BAD}: 2 body and support, 2 body and element",
        f"{DOCUMENTS}: test_each_entry_of_toml_has_its_line",
    ),
    3: (
        "bad names",
        f"{BAD}: 3 name, test_names_that_look_alike_are_warned_of, test_other_names_are_good",
    ),
    4: ("mass not above 0", f"{BAD}: 4 mass, 4 no mass", f"{TRACED}: 4 mass, 4 no mass"),
    5: (
        "a number that is NaN or infinite",
        f"{BAD}: 5 NaN mass, 5 infinite mass, 5 text",
        f"{TRACED}: 5 NaN, 5 infinite",
    ),
    6: (
        "tiny mass or inertia",
        f"{BAD}: test_elements_without_effect_and_tiny_masses_issue_warnings",
    ),
    7: ("inertia of another shape", f"{BAD}: 7 two moments, 7 one moment, 7 small matrix"),
    8: ("asymmetric inertia", f"{BAD}: 8 asymmetric"),
    9: ("indefinite inertia", f"{BAD}: 9 indefinite", f"{TRACED}: 9 inertia"),
    10: ("triangle inequality", f"{BAD}: 10 triangle", f"{TRACED}: 10 triangle"),
    11: (
        "triangle inequality, by rounding",
        f"{BAD}: test_a_true_inertia_is_never_rejected_for_its_round_off",
    ),
    12: (
        "inertia of a rod or a point",
        (
            "model/test_bodies.py: "
            "test_what_may_turn_without_inertia_is_reported_when_a_model_is_built"
        ),
    ),
    13: ("products of inertia of the other sign", f"{BAD}: 10 signs of products"),
    14: ("inertia about the origin", f"{DIAGNOSES}: kg mm2 for kg m2, points in mm"),
    15: (
        "a matrix that is no rotation",
        f"{BAD}: 15 scaled, 15 mirrored, 15 rounded",
        f"{TRACED}: 15 scaled, 15 mirrored",
    ),
    16: (
        "a quaternion that is zero or not of unit length",
        f"{BAD}: 16 zero, 16 not unit, 16 angles",
    ),
    17: (
        "quaternions that change sign or jump",
        f"{MOTIONS}: test_rotations_are_followed_over_more_than_a_turn, jump",
    ),
    18: (
        "Euler angles without a sequence",
        f"{BAD}: 18 no sequence, 18 mixed sequence, 18 axis twice, 18 two angles",
    ),
    19: ("a spring of no length", f"{BAD}: 19 no length"),
    20: ("no length without a free length", f"{BAD}: test_special_cases_that_are_allowed"),
    21: (
        "a spring that passes through no length",
        f"{CAUSES}: test_a_spring_that_passes_through_zero_length_is_named_with_the_time",
    ),
    22: (
        "negative stiffness",
        f"{BAD}: 22 stiffness, 22 bushing",
        f"{TRACED}: 22 stiffness, 22 bushing, 22 law",
    ),
    23: ("negative damping", f"{BAD}: 23 damping, 23 bushing", f"{TRACED}: 23 damping"),
    24: (
        "a stiffness matrix without a potential",
        f"{BAD}: 24 asymmetric, 24 indefinite",
        f"{TRACED}: 24 asymmetric, 24 indefinite",
    ),
    25: ("no stiffness along an axis of a bushing", f"{BAD}: test_special_cases_that_are_allowed"),
    26: ("both ends on one body", f"{BAD}: 26 one body, 26 bushing"),
    27: (
        "both ends on supports",
        f"{BAD}: test_elements_without_effect_and_tiny_masses_issue_warnings",
    ),
    28: (
        "bad tables of forces",
        "model/laws/test_laws.py: TABLE_SHORT, TABLE_UNSORTED, TABLE_DUPLICATE, TABLE_FALLS",
        "motion/test_suspensions.py: test_a_motion_that_leaves_a_table_reports_which_and_when",
        f"{TRACED}: 28 table, 28 falls",
    ),
    29: (
        "a body attached to nothing",
        f"{STATICS}: test_an_unattached_body_has_no_equilibrium",
        f"{SIMULATIONS}: test_an_unattached_body_moves_with_a_warning",
    ),
    30: (
        "a singular stiffness",
        f"{STATICS}: test_plate_on_a_line_of_springs_is_free_to_turn_about_the_line",
    ),
    31: (
        "a nearly singular stiffness",
        f"{STATICS}: test_nearly_singular_stiffness_is_reported_before_it_is_inaccurate",
    ),
    32: (
        "an unstable equilibrium",
        f"{STATICS}: test_an_inverted_pendulum_started_upright_is_unstable",
    ),
    33: (
        "several equilibria",
        f"{LOADS}: test_two_stable_equilibria_and_the_one_between_are_found",
    ),
    34: ("no equilibrium", f"{LOADS}: test_no_equilibrium_states_the_carried_load"),
    35: ("a limit point", f"{LOADS}: test_a_limit_point_is_found_where_the_force_is_largest"),
    36: (
        "a search with too few steps",
        f"{STATICS}: test_a_search_with_too_few_steps_reports_its_residual",
    ),
    37: (
        "a derivative through a failure",
        f"{STATICS}: test_derivative_through_a_failed_or_singular_equilibrium_is_nan",
    ),
    38: (
        "too many steps",
        (
            f"{SIMULATIONS}: "
            "test_a_motion_of_too_many_steps_keeps_its_samples_and_reports_the_time_reached"
        ),
    ),
    39: ("steps too short", f"{SIMULATIONS}: test_steps_below_the_smallest_are_reported"),
    40: (
        "constant steps too long",
        (
            f"{SIMULATIONS}: "
            "test_constant_steps_too_long_for_the_model_end_in_a_status_at_the_right_time"
        ),
    ),
    41: (
        "a force that is not finite",
        f"{CAUSES}: test_a_nonfinite_law_in_a_motion_is_named_with_its_element_and_deformation",
    ),
    42: (
        "a state that escapes",
        f"{SIMULATIONS}: test_a_nonfinite_motion_is_named",
        (
            f"{CAUSES}: test_a_body_that_escapes_is_warned_of, "
            "test_a_body_that_travels_with_its_support_or_falls_has_not_escaped"
        ),
    ),
    43: (
        "an initial state of another shape",
        f"{SIMULATIONS}: test_initial_states_that_do_not_fit_are_refused",
    ),
    44: (
        "other kinds of arrays",
        f"{BAD}: 44 object, 44 nothing, 44 ragged, 44 dates, 44 masked, "
        "test_whole_numbers_become_floats_and_what_was_given_is_not_changed",
    ),
    45: ("complex numbers", f"{BAD}: 45 mass, 45 inertia, 45 bushing, 45 gravity, 45 under jit"),
    46: (
        "single precision",
        f"{SIMULATIONS}: test_float32_warns_once_is_refused_for_modes_and_never_mixed",
        f"{FITS}: test_float32_is_refused",
    ),
    47: (
        "the switch of precision moved",
        (
            "numerics/test_precisions.py: "
            "test_a_state_of_the_other_precision_is_refused_with_what_to_do"
        ),
    ),
    48: (
        "devices without float64 or eig",
        "numerics/test_devices.py: test_a_device_without_eig_is_named_with_the_line_to_set",
        (
            "no message where float64 is missing: JAX itself refuses such arrays, and no "
            "such device was at hand"
        ),
    ),
    49: (
        "times outside a motion",
        f"{SIMULATIONS}: test_times_outside_a_sampled_motion_are_refused",
        (
            "fitting/experiments/test_experiments.py: "
            "test_a_motion_that_ends_before_the_record_is_refused_before_a_model_is_there"
        ),
    ),
    50: ("times that go back", f"{RECORDS}: unsorted", f"{MOTIONS}: unsorted"),
    51: (
        "times twice",
        f"{RECORDS}: repeated, test_repeated_rows_are_dropped_on_request_and_noted",
        f"{MOTIONS}: duplicated",
    ),
    52: ("NaN in times", f"{RECORDS}: NaN in times", f"{MOTIONS}: NaN time, infinite time"),
    53: (
        "NaN in a motion",
        f"{MOTIONS}: NaN motion, NaN turn",
        f"{RECORDS}: test_short_gaps_are_filled_on_request_and_long_ones_stay",
    ),
    54: (
        "a support that jumps",
        f"{MOTIONS}: test_a_sampled_motion_that_jumps_is_warned_of",
        "model/inputs/test_base_motions.py: test_a_jump_of_the_base_issues_a_warning",
    ),
    55: ("a support that turns too far between samples", f"{MOTIONS}: jump"),
    56: ("a low sampling rate", f"{RECORDS}: few samples for what matters, too few samples"),
    57: ("another rate than stated", f"{RECORDS}: another rate"),
    58: ("uneven or missing samples", f"{RECORDS}: jitter, samples missing"),
    59: ("a late record", f"{DIAGNOSES}: late, early"),
    60: (
        "times in milliseconds",
        f"{RECORDS}: milliseconds",
        f"{DIAGNOSES}: test_times_in_milliseconds_are_named",
    ),
    61: (
        "degrees for radians",
        f"{BAD}: 61 degrees, test_angles_in_degrees_are_warned_of",
        f"{RECORDS}: degrees for radians",
    ),
    62: (
        "mm for m, N/mm for N/m",
        f"{DIAGNOSES}: N/mm for N/m, points in mm, stiffness in nothing known",
    ),
    63: ("kg mm2 for kg m2", f"{DIAGNOSES}: kg mm2 for kg m2"),
    64: (
        "g for m/s2, gravity in a record",
        f"{RECORDS}: g for m/s2, m/s2 for g",
        f"{DIAGNOSES}: test_gravity_that_was_taken_out_of_a_record_is_named",
    ),
    65: ("unusual gravity", f"{DIAGNOSES}: gravity in mm/s2"),
    66: (
        "unknown units",
        (
            f"{RECORDS}: test_unknown_units_are_reported, unit of another kind, units that "
            "differ, times in meters"
        ),
    ),
    67: ("left-handed axes in data", f"{DIAGNOSES}: left-handed"),
    68: (
        "data of another shape",
        f"{SENSORS}: test_a_transposed_record_is_reported_to_be_one",
        f"{RECORDS}: transposed",
    ),
    69: (
        "no data",
        f"{SENSORS}: test_no_data_and_one_sample_are_no_experiment",
        f"{RECORDS}: no data, one sample",
    ),
    70: (
        "a channel of NaN",
        f"{SENSORS}: test_a_channel_without_any_sample_is_named",
        f"{RECORDS}: no sample in a column",
    ),
    71: (
        "a channel with gaps",
        f"{SENSORS}: test_above_a_fifth_missing_warns_and_below_does_not",
        f"{RECORDS}: a third missing",
    ),
    72: (
        "a dead or saturated channel",
        f"{SENSORS}: test_a_dead_or_saturated_channel_of_an_experiment_is_warned_of",
        f"{RECORDS}: dead, saturated",
    ),
    73: ("channels exchanged", f"{DIAGNOSES}: swapped"),
    74: ("units off by a factor", f"{DIAGNOSES}: millimeters, inches, degrees, sign"),
    75: ("noise not above 0", f"{SENSORS}: test_noise_of_an_experiment_must_be_positive"),
    76: ("parameters that are none", f"{FITS}: UNKNOWN_PATH, LISTED_TWICE, NOTHING_FREE"),
    77: ("bounds out of order", f"{FITS}: BAD_BOUNDS"),
    78: ("a start outside its bounds", f"{FITS}: START_OUTSIDE"),
    79: (
        "a start at a bound",
        f"{FITS}: START_ON_BOUND",
        "fitting/test_domains.py: test_from_zero_a_fit_says_what_to_do",
    ),
    80: (
        "a fit that ends at a bound",
        f"{FITS}: test_a_bound_that_is_met_is_named_and_the_rest_is_the_optimum_on_it",
    ),
    81: (
        "parameters that data do not determine",
        f"{FITS}: test_what_the_data_cannot_tell_is_said_in_words_and_has_no_number",
    ),
    82: ("parameters without effect", f"{FITS}: test_parameters_without_any_effect_are_named"),
    83: (
        "a start that cannot be simulated",
        f"{FITS}: test_a_start_that_cannot_be_simulated_names_the_element_the_time_and_the_channel",
    ),
    84: (
        "trials that cannot be simulated",
        f"{FITS}: test_trials_that_cannot_be_simulated_are_steps_rejected_and_counted",
    ),
    85: (
        "several optima",
        (
            f"{LOSSES}: test_many_starts_find_the_optima_that_scipy_finds, "
            "test_optima_that_explain_as_much_are_warned_of"
        ),
    ),
    86: (
        "correlated residuals",
        f"{FITS}: test_correlated_residuals_are_reported_and_white_ones_are_not",
    ),
    87: (
        "other encodings",
        f"{RECORDS}: latin-1, utf-16, test_a_byte_order_mark_and_blank_lines_do_no_harm",
    ),
    88: (
        "decimal commas, mixed rows, footers",
        f"{RECORDS}: decimal comma, mixed rows, footer, thousands",
    ),
    89: (
        "files that are missing, empty or truncated",
        f"{RECORDS}: test_a_file_that_is_missing_or_a_directory, empty, ends in a line",
    ),
    90: (
        "files and models that are too large",
        f"{RECORDS}: too large, packed tightly",
        "app/test_commands.py: test_what_is_too_large_is_refused_with_its_estimate_and_the_setting",
    ),
    91: (
        "malicious files",
        f"{FILES}: test_mutated_files_are_models_or_clear_errors",
        "files/test_safety.py: test_no_file_can_run_anything",
        f"{DOCUMENTS}: test_deep_nesting_is_refused_before_it_is_parsed",
    ),
    92: (
        "keys twice or unknown, a newer version",
        f"{FILES}: test_problems_are_reported_with_their_line",
        f"{DOCUMENTS}: test_files_are_checked_before_they_are_read",
    ),
    93: ("Ctrl-C", f"{LOSSES}: test_an_interrupted_fit_keeps_its_best_and_goes_on_from_there"),
    94: (
        "a disk that is full",
        (
            f"{LOSSES}: "
            "test_a_full_disk_and_ctrl_c_leave_the_old_checkpoint_and_a_wrong_one_is_reported"
        ),
    ),
    95: (
        "too much memory in reverse mode",
        (
            "core/test_failures.py: "
            "test_a_derivative_that_would_reserve_too_much_memory_is_refused_before"
        ),
    ),
    96: (
        "recompilation",
        (
            "core/compilation/test_compile_options.py: "
            "test_new_floats_compile_nothing_and_other_words_do"
        ),
    ),
}

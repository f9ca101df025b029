/* All tests; each stops the program if it fails. The name says what it protects, the comment in the source why. */
#ifndef FLEXFMU_TESTS_H
#define FLEXFMU_TESTS_H

#define TESTS(X)                                \
  X(linear_solvers_invert)                      \
  X(linear_solvers_refuse_singular_matrices)    \
  X(tableaus_meet_the_order_conditions)         \
  X(tableaus_are_symplectic)                    \
  X(explicit_tableaus_meet_the_order_conditions) \
  X(tableaus_are_diagonal_in_their_eigenvectors) \
  X(inputs_are_polynomials)                     \
  X(inputs_forget_derivatives_when_set)         \
  X(tolerance_is_achieved)                      \
  X(tolerance_is_achieved_between_short_steps)  \
  X(stiff_modes_at_rest_cost_nothing)           \
  X(stiff_modes_in_motion_are_resolved)         \
  X(work_without_end_is_told)                   \
  X(forced_motion_is_exact)                     \
  X(jumps_of_the_input_are_met)                 \
  X(inputs_that_go_on_cost_nothing)             \
  X(jerks_are_noticed)                          \
  X(every_method_has_its_order)                 \
  X(every_method_meets_the_tolerance)           \
  X(radau_damps_and_gauss_does_not)             \
  X(automatic_damps_only_what_is_damped)        \
  X(accelerations_belong_to_the_end_of_a_step)  \
  X(fixed_steps_that_are_too_long_are_explained) \
  X(every_method_rolls_back)                    \
  X(energy_stays_over_many_steps)               \
  X(energy_stays_in_nonlinear_motion)           \
  X(orbit_keeps_energy_and_momentum)            \
  X(step_sizes_from_nanoseconds_to_seconds)     \
  X(rest_stays_at_rest)                         \
  X(static_equilibrium_is_found)                \
  X(static_equilibrium_may_be_missing)          \
  X(rates_of_outputs_are_exact)                 \
  X(rigid_models_follow_their_inputs)           \
  X(parameters_may_be_tuned)                    \
  X(rates_follow_the_power)                     \
  X(failures_are_explained)                     \
  X(unsolvable_equations_are_given_up)          \
  X(blow_up_is_reported)                        \
  X(bad_inputs_leave_no_trace)                  \
  X(stick_slip_follows_its_closed_form)         \
  X(fixed_steps_end_at_events)                \
  X(sticking_is_a_state)                      \
  X(breakaway_is_met_within_a_step)           \
  X(two_frictions_keep_the_balance)           \
  X(friction_rolls_back)                      \
  X(chatter_is_bounded)                       \
  X(rates_with_friction_are_exact)            \
  X(coupled_frictions_release_what_must_slip) \
  X(the_most_overloaded_friction_lets_go_first) \
  X(fmi_model_exchange)                         \
  X(fmi_model_exchange_is_checked)              \
  X(fmi_model_exchange_states_are_restored)     \
  X(fmi_directional_derivatives)                \
  X(fmi_life_cycle)                             \
  X(fmi_instantiation_is_checked)               \
  X(fmi_values_are_checked)                     \
  X(fmi_rollback_is_exact)                      \
  X(fmi_singularity_discards_the_step)          \
  X(fmi_nan_discards_the_step)                  \
  X(fmi_allocates_once)                         \
  X(fmi_logs_what_is_asked_for)                 \
  X(fmi_inputs_jump_at_communication_points)    \
  X(fmi_runs_a_hundred_thousand_steps)

#define X(name) void test_##name(void);
TESTS(X)
#undef X

#endif

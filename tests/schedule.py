"""Which worker runs which tests, and in which order: what takes long begins early.

Tests in real time mostly wait: more of them run at a time than there are cores, and nothing else beside them.
A file whose tests share something expensive stays on one worker; a file of long tests is spread over all.
"""

from itertools import chain, combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

from _pytest.mark.expression import Expression
from xdist.scheduler import LoadScopeScheduling

if TYPE_CHECKING:
    import pytest

#: Files and tests in real time, in the order in which they begin.
REALTIME = (
    "tests/docs/test_commands.py::test_the_commands_of_a_page",
    "tests/cli/bus/test_servos_command.py",
    "tests/cli/sim/test_board_command.py",
    "tests/server/test_keeper.py",
    "tests/server/test_link_faults.py",
    "tests/server/test_standstill.py",
    "tests/faults/test_relay.py",
    "tests/faults/test_command.py",
    "tests/server/test_steered_link.py",
    "tests/server/test_failing_link.py",
    "tests/server/test_lockout.py",
    "tests/server/test_frozen_viewers.py",
    "tests/client/test_stop_client.py",
    "tests/simulators/test_servo_board.py",
    "tests/client/test_remote.py",
    "tests/cli/test_foreign_text.py::test_a_ro",
    "tests/backends/bus/test_register_bus.py::test_the",
    "tests/backends/bus/test_lx16a_servos.py",
    "tests/backends/bus/test_servos.py",
    "tests/backends/bus/test_tools_scan.py",
    "tests/backends/bus/test_register_servo_settings.py",
    "tests/backends/bus/test_register_servo.py::test_the",
    "tests/control/calibration/test_servo_trial.py",
    "tests/control/calibration/test_servo_identification.py",
    "tests/backends/bus/test_tools_lost_id.py",
    "tests/backends/bus/test_line_condition.py::test_on_a_bus",
    "tests/control/calibration/test_servo_calibration.py",
    "tests/backends/pwm/test_servo2040.py",
    "tests/backends/pwm/test_i2c_socket.py",
    "tests/simulators/test_pca9685_board.py",
    "tests/backends/zenoh/test_zenoh_client.py",
    "tests/backends/mavlink/test_mavlink_client.py",
    "tests/backends/mavlink/test_mavlink_client_faults.py",
    "tests/cli/network/test_serve_command.py",
    "tests/server/ros/test_bridge.py",
    "tests/cli/walk/test_drive_command.py",
    "tests/cli/walk/test_drive_command_soak.py",
    "tests/teleop/test_drive_page.py",
    "tests/teleop/test_page_connection.py",
    "tests/teleop/test_picture_relay.py",
    "tests/server/ros/test_bridge_drive.py",
    "tests/cli/network/test_early_stop.py::test_the_robot",
    "tests/cli/network/test_status_command.py",
    "tests/cli/results/test_view_command.py",
    "tests/wire/test_zenoh_session.py",
    "tests/cli/bus/test_calibrate_command.py",
    "tests/cli/walk/test_run_command.py::test_ctrl_c",
    "tests/cli/test_hangup.py",
    "tests/cli/test_settings.py::test_a_process",
    "tests/recording/test_live.py",
    "tests/vision/video/test_video_source.py",
    "tests/vision/video/test_mjpeg.py",
    "tests/vision/twin/test_posture_history.py",
    "tests/vision/twin/test_twin_camera.py",
    "tests/vision/test_robot_link.py",
    "tests/vision/test_latency_trial.py::test_a_twist",
    "tests/vision/test_latency_trial.py::test_ctrl_c",
    "tests/vision/test_latency_trial.py::test_a_robot",
    "tests/cli/see/test_see_command.py",
    "tests/cli/sim/test_camera_command.py",
    # Renders pictures for minutes, beside which others get no time.
    "tests/cli/see/test_see_command_unattended.py",
)

#: Files that take long on the one worker they stay on.
EARLY = (
    "tests/cli/study/test_prior_command.py",
    "tests/study/paper/test_study_report.py",
    "tests/study/paper/test_claims.py",
    "tests/adapt/prior/test_samples.py",
    "tests/control/test_trial.py",
)

#: Commands, programs, viewers and studies from end to end, and searches over many walks: `.ci/run` and
#: `make test-all` run them, `make test` and `make check` do not.
SLOW = (
    "tests/adapt/prior/test_prior.py::test_no_byte_can_be_changed_unnoticed",
    "tests/adapt/test_kill.py",
    "tests/adapt/optimizers/test_population.py::test_it_converges_as_scipys_does",
    "tests/adapt/optimizers/test_population.py::test_the_comparison_would_notice_another_factor_or_strategy",
    "tests/cli/walk/test_adapt_command.py",
    "tests/cli/walk/test_adapt_command_robot.py",
    "tests/cli/walk/test_demo_command.py",
    "tests/cli/test_console.py::test_a_reader_that_has_gone_is_no_error",
    "tests/cli/test_console.py::test_a_result_that_cannot_be_written_is_a_fault",
    "tests/cli/test_main.py::test_a_missing_extra_is_named",
    "tests/cli/test_main.py::test_a_robots_computer_needs_no_extras",
    "tests/cli/test_meshes.py",
    "tests/cli/walk/test_run_command.py::test_a_disk_without_room_is_said_before_the_walk",
    "tests/cli/walk/test_run_command.py::test_a_full_disk_costs_neither_the_walk_nor_its_result",
    "tests/cli/walk/test_run_command.py::test_runs_that_begin_together_all_have_a_recording",
    "tests/cli/walk/test_run_command.py::test_the_same_seed_gives_the_same_walk",
    "tests/control/test_batch.py::test_a_batch_equals_its_single_trials[loaded",
    "tests/control/test_batch.py::test_a_batch_equals_its_single_trials[rough",
    "tests/control/test_controllers_seam.py::test_a_controller_that_looks_at_the_state_walks_the_same_alone_and_in_a"
    "_batch[rough",
    "tests/control/test_trial.py::test_every_robot_with_every_failure_comes_to_a_result[phantomx",
    "tests/control/test_trial_heading_invariance.py",
    "tests/control/test_trial_start_line.py",
    "tests/control/walks/test_turning.py::test_the_failed_leg_trails_when_the_walk_begins[phantomx",
    "tests/control/assessment/test_uncertainty.py::test_a_coarse_step_is_more_uncertain_than_a_fine_one",
    "tests/control/assessment/test_uncertainty.py::test_a_robot_is_measured_over_gaits_and_legs",
    "tests/control/assessment/test_uncertainty.py::test_each_walk_is_compared_with_a_finer_one_in_its_own_world",
    "tests/control/assessment/test_uncertainty.py::test_it_is_how_far_each_walk_ends_elsewhere",
    "tests/control/assessment/test_uncertainty.py::test_walks_without_an_end_are_left_out",
    "tests/demo/test_rescue.py",
    "tests/docs/test_blocks.py",
    "tests/docs/test_rescue.py",
    "tests/docs/test_commands.py::test_the_commands_of_a_page",
    "tests/docs/test_site.py::test_the_figures_are_what_their_script_makes",
    "tests/docs/test_site.py::test_the_site_builds_without_a_warning",
    "tests/docs/test_step_response.py",
    "tests/examples/",
    "tests/faults/test_command.py",
    "tests/study/paper/test_claims_distance_criterion.py::test_the_bar_is_the_mean_of_what_each_leg_allows",
    "tests/study/paper/test_claims.py::test_a_single_good_gait_is_found_late",
    "tests/study/paper/test_claims.py::test_no_claim_about_searches_is_green_on_random_numbers",
    "tests/study/test_walking.py",
    "tests/study/test_landscape.py",
    "tests/study/paper/test_matrix.py::test_a_matrix_is_walked_once_and_written",
    "tests/study/paper/test_study_report.py",
    "tests/study/paper/test_study_plan_study.py",
    "tests/study/transfer/test_transfer_plan.py::test_one_world_one_optimizer_and_one_trial_make_a_report_too",
    "tests/study/transfer/test_transfer_plan.py::test_the_report_is_one_page_with_figures_and_table_beside_it",
    "tests/test_compatibility.py::test_a_stored_session_is_shown_and_goes_on_as_it_would_have",
    "tests/test_compatibility.py::test_json_of_the_commands",
    "tests/test_compatibility.py::test_recordings_and_tables",
    "tests/test_compatibility.py::test_trials_in_one_batch",
    "tests/testing/test_servo_conformance.py::test_good_servos_pass_and_bad_ones_fail",
    "tests/viewer/",
    "tests/cli/test_doctor_command.py",
    "tests/cli/test_interrupts.py",
    "tests/cli/test_settings.py::test_a_stop_is_asked_for_whatever_is_wrong",
    "tests/control/test_batch.py::test_trials_of_many_worlds_and_failures_are_stepped_together_and_each"
    "_is_as_alone",
    "tests/control/monitor/test_monitored_walk.py::test_each_walk_of_a_batch_recovers_by_itself_as_alone",
    "tests/vision/test_robot_camera.py",
    "tests/vision/test_observer_disturbed.py",
    "tests/study/test_repertoire_plan_building.py::test_walks_of_a_cluster",
    "tests/study/paper/test_study_report_default_gaits.py::test_the_report_has_them_beside_the_searches",
    "tests/study/paper/test_claims.py::test_claims_about_searches",
    "tests/cli/robot/test_check_command.py::test_the_simulations_own_uncertainty_is_measured_and_kept",
    "tests/recording/test_rrd_reader.py",
    "tests/doctor/test_checkup.py",
)

#: Tests that took more than 0.8 s of a core each when all were timed, besides those above; with an id in
#: brackets where the others of a test are quicker.
MEASURED = frozenset((Path(__file__).parent / "slow_tests.txt").read_text(encoding="utf-8").splitlines())

#: Slow tests that `make test-all` alone runs: what they add to their neighbours is another robot, benchmark,
#: page or length of the same, and together they take as long as all others.
LONG = (
    "tests/adapt/prior/test_samples.py",
    "tests/adapt/test_reset_free.py",
    "tests/backends/bus/test_line_condition.py::test_on_a_bus",
    "tests/backends/bus/test_tools_scan.py::test_the_only_servo_on_a_bus_takes_an_id",
    "tests/benchmarks/test_command.py",
    "tests/cli/bus/test_servos_command.py::test_a_scan",
    "tests/cli/bus/test_servos_command.py::test_servos_at_another_baud",
    "tests/cli/see/test_see_command_unattended.py",
    "tests/cli/study/test_prior_command.py",
    "tests/cli/study/test_study_command.py",
    "tests/cli/test_completion.py",
    "tests/cli/walk/test_adapt_command.py::test_a_session_cut_off_goes_on_to_the_same_end",
    "tests/cli/walk/test_demo_command.py::test_json",
    "tests/cli/walk/test_drive_command_soak.py",
    "tests/control/calibration/test_servo_identification.py",
    "tests/control/test_batch.py::test_trials_of_many_worlds_and_failures_are_stepped_together_and_each"
    "_is_as_alone[heading",
    "tests/control/test_batch.py::test_trials_of_many_worlds_and_failures_are_stepped_together_and_each"
    "_is_as_alone[none",
    "tests/docs/test_blocks.py::test_the_programs_of_a_page_run[CONTRIBUTING.md",
    "tests/docs/test_blocks.py::test_the_programs_of_a_page_run[adaptation.md",
    "tests/docs/test_blocks.py::test_the_programs_of_a_page_run[notebooks.md",
    "tests/docs/test_blocks.py::test_the_programs_of_a_page_run[recovery.md",
    "tests/docs/test_blocks.py::test_the_programs_of_a_page_run[see.md",
    "tests/docs/test_blocks.py::test_the_programs_of_a_page_run[study.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[adaptation.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[bus-servos.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[dynamixel.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[export.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[feetech.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[lx16a.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[pca9685.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[priors.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[pwm-servos.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[real-robot.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[robot-computer.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[ros2.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[see.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[servo2040.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[steering.md",
    "tests/recording/test_recording_memory.py::test_memory_does_not_grow_with_the_length_of_a_walk",
    "tests/robot/test_configs_sources.py::test_each_walks_without_any_of_its_legs",
    "tests/vision/test_latency_trial.py::test_ctrl_c",
    "tests/server/test_steered_link.py",
    "tests/viewer/test_live.py::test_a_window_that_dies_or_hangs_loses_no_tick",
    "tests/adapt/optimizers/test_population.py::test_it_converges_as_scipys_does[BestEvolution-best1bin-rosenbrock",
    "tests/adapt/optimizers/test_population.py::test_it_converges_as_scipys_does[RandomEvolution",
    "tests/backends/bus/test_tools_lost_id.py::test_it_is_named_at_connect_and_adopted[dynamixel",
    "tests/backends/bus/test_tools_lost_id.py::test_it_is_named_at_connect_and_adopted[feetech",
    "tests/cli/see/test_see_command.py::test_a_robot_walks_by_the_pose_that_a_camera_sees",
    "tests/cli/test_main.py::test_a_missing_extra_is_named[cv2",
    "tests/cli/test_main.py::test_a_missing_extra_is_named[mujoco",
    "tests/cli/test_main.py::test_a_missing_extra_is_named[pyarrow",
    "tests/control/calibration/test_servo_trial.py::test_a_good_servo_follows[dynamixel-xl3",
    "tests/control/calibration/test_servo_trial.py::test_a_good_servo_follows[feetech-scs",
    "tests/control/calibration/test_servo_trial.py::test_a_servo_moves_a_little_and_back_and_no_other_does[dynamixel-xl3",
    "tests/control/calibration/test_servo_trial.py::test_a_servo_moves_a_little_and_back_and_no_other_does[feetech-scs",
    "tests/control/test_trial.py::test_every_robot_with_every_failure_comes_to_a_result[pexod",
    "tests/control/test_trial.py::test_every_robot_with_every_failure_comes_to_a_result[phantomx-l",
    "tests/control/test_trial.py::test_every_robot_with_every_failure_comes_to_a_result[phantomx-s",
    "tests/control/test_trial.py::test_every_robot_with_every_failure_comes_to_a_result[phantomx-u",
    "tests/control/test_trial.py::test_every_robot_with_every_failure_comes_to_a_result[phantomx-w",
    "tests/control/walks/test_turning.py::test_the_failed_leg_trails_when_the_walk_begins[phantomx-1",
    "tests/control/walks/test_turning.py::test_the_failed_leg_trails_when_the_walk_begins[phantomx-2",
    "tests/control/walks/test_turning.py::test_the_failed_leg_trails_when_the_walk_begins[phantomx-3",
    "tests/control/walks/test_turning.py::test_the_failed_leg_trails_when_the_walk_begins[phantomx-4",
    "tests/control/walks/test_turning.py::test_the_failed_leg_trails_when_the_walk_begins[phantomx-5",
    "tests/docs/test_blocks.py::test_the_programs_of_a_page_run[driving.md",
    "tests/docs/test_blocks.py::test_the_programs_of_a_page_run[export.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[firmware.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[get-started.md",
    "tests/docs/test_commands.py::test_the_commands_of_a_page[walking.md",
    "tests/faults/test_command.py::test_a_fault_ends_the_motion_or_does_not_as_is_safe[controller-killed",
    "tests/faults/test_command.py::test_a_fault_ends_the_motion_or_does_not_as_is_safe[cable-out/zenoh",
    "tests/faults/test_command.py::test_a_fault_ends_the_motion_or_does_not_as_is_safe[none",
    "tests/faults/test_command.py::test_a_fault_ends_the_motion_or_does_not_as_is_safe[viewer-killed",
    "tests/recording/test_live.py::test_a_viewer_that_dies_or_hangs_holds_nothing_up[9-feeder",
    "tests/recording/test_live.py::test_a_viewer_that_dies_or_hangs_holds_nothing_up[19-viewer",
    "tests/vision/test_latency_trial.py::test_a_twist",
    "tests/test_compatibility.py::test_a_stored_session_is_shown_and_goes_on_as_it_would_have[cut-dps",
    "tests/test_compatibility.py::test_a_stored_session_is_shown_and_goes_on_as_it_would_have[cut-pso",
)

#: Files whose tests are spread one by one.
SPREAD = (
    "tests/docs/test_commands.py::test_the_commands_of_a_page",
    "tests/adapt/test_reset_free.py",
    "tests/adapt/test_kill.py",
    "tests/benchmarks/test_command.py",
    "tests/test_compatibility.py",
    "tests/cli/walk/test_adapt_command.py",
    "tests/cli/study/test_study_command.py",
    "tests/cli/test_completion.py",
    "tests/study/test_walking.py",
    "tests/study/test_landscape.py",
    "tests/adapt/optimizers/test_population.py",
    "tests/viewer/",
)


def scope_of(nodeid: str) -> str:
    """What stays together with a test: nothing, or its file."""
    return nodeid if nodeid.startswith(SPREAD) else nodeid.partition("::")[0]


def markers_of(nodeid: str) -> list[str]:
    """Markers of a test by its place: of `realtime`, `slow` and `long`, which is slow too."""
    slow = nodeid.startswith(SLOW + LONG) or nodeid in MEASURED or nodeid.partition("[")[0] in MEASURED
    places = {"realtime": nodeid.startswith(REALTIME), "slow": slow, "long": nodeid.startswith(LONG)}
    return [marker for marker, there in places.items() if there]


def may_select(expression: str, file: str) -> bool:
    """Whether an expression of markers may select tests of a file, which need not be imported otherwise."""
    wanted = Expression.compile(expression)
    places = {"realtime": REALTIME, "slow": (*SLOW, *LONG, *MEASURED), "long": LONG}
    if not wanted.idents() <= {*places, "soak"}:
        return True
    certain = {marker for marker, there in places.items() if file.startswith(there)}
    some = {marker for marker, there in places.items() if any(name.startswith(f"{file}::") for name in there)}
    possible = sorted(some | {"soak"})
    sets = chain.from_iterable(combinations(possible, count) for count in range(len(possible) + 1))
    return any(_selects(wanted, certain.union(more)) for more in sets)


def _selects(wanted: Expression, markers: set[str]) -> bool:
    return wanted.evaluate(lambda name, /, **_: name in markers)


def rank(nodeid: str) -> int:
    """When a test begins: those in real time in their order, then what takes long."""
    for place, prefix in enumerate(REALTIME):
        if nodeid.startswith(prefix):
            return place
    later = 1 if nodeid.startswith(EARLY) else 2 if nodeid.startswith(SPREAD) else 3
    return len(REALTIME) + later


class Schedule(LoadScopeScheduling):  # type: ignore[misc]
    """Gives scopes to workers in the order of `rank`."""

    def __init__(self, config: "pytest.Config", log: Any = None) -> None:
        config.option.loadscopereorder = False
        super().__init__(config, log)

    def _split_scope(self, nodeid: str) -> str:
        return scope_of(nodeid)


def ordered(items: "list[pytest.Item]") -> "list[pytest.Item]":
    """Tests in the order in which they are given to workers."""
    return sorted(items, key=lambda item: rank(item.nodeid))

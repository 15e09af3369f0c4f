"""How much of everything a run of the benchmarks does."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """Sizes of the benchmarks.

    Attributes:
        rounds: how often ours and the reference alternate.
        trial_rounds: the same where one round is a single trial.
        codes: gaits of a batch, evenly spread over the 120.
        batch_walk_s: duration of the walks of the batch.
        walk_s: duration of a single walk and of the walks of a study.
        ticks: control ticks per round of the tick benchmark.
        clock_s: how long the wall clock is watched.
        link_s: how long round trips over the link are measured.
        flood_s: how long commands are counted during a flood of foreign ones.
        twin_s: how long a robot at the other end of the link walks.
        bus_s: how long each of the robots on a bus walks.
        memory_s: how long a simulated robot walks while its memory is watched.
        memory_link_s: the same over the link, in real time.
        starts: how often a process is started.
        see_step_m: grid of the floor on which a camera looks for the robot.
        see_walks: walks that hold their line by a camera.
        see_walk_s: how long each of them is.
        robots: of each verdict of a check.
    """

    rounds: int
    trial_rounds: int
    codes: int
    batch_walk_s: float
    walk_s: float
    ticks: int
    clock_s: float
    link_s: float
    flood_s: float
    twin_s: float
    bus_s: float
    memory_s: float
    memory_link_s: float
    starts: int
    see_step_m: float
    see_walks: int
    see_walk_s: float
    robots: int


FULL = Scale(
    rounds=7,
    trial_rounds=21,
    codes=120,
    batch_walk_s=10.0,
    walk_s=30.0,
    ticks=5000,
    clock_s=60.0,
    link_s=60.0,
    flood_s=10.0,
    twin_s=600.0,
    bus_s=600.0,
    memory_s=3600.0,
    memory_link_s=3600.0,
    starts=7,
    see_step_m=0.25,
    see_walks=12,
    see_walk_s=15.0,
    robots=20,
)

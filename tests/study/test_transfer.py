"""The transfer benchmark on made-up landscapes: its settings, searches and report."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from hexctl.adapt.prior.prior import PriorKey
from hexctl.adapt.prior.samples import FINAL, samples_of
from hexctl.backends.sim.world import load_randomization
from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.failure import Failure, drawn_failure
from hexctl.study.experiment import where
from hexctl.study.landscape import NUMBERS, Landscape, LandscapeSpec
from hexctl.study.priors.prior_building import PriorPlan
from hexctl.study.transfer.transfer_plan import (
    EARLY,
    TransferPlan,
    make_search,
    run_course,
    search_worlds,
    walk_of,
)
from hexctl.types import FloatArray
from tests.adapt.priors import MadeUpModel, key_of, made_up_prior, path_of, plan_of
from tests.robots import shipped

if TYPE_CHECKING:
    from pandas import DataFrame


DURATION_S = 6.0
LEGS, WORLDS, BUDGET, RUNS = (2, 5), 3, 20, 2
OPTIMIZERS = ("bayes", EARLY, "pso", "random")
MODEL = MadeUpModel(seed=4)

#: Codes of gaits that fall after half of their time.
FALLING = (12, 51, 94)


def question(name: str = "ant", **options: Any) -> PriorKey:
    return key_of(shipped(name), **{"duration_s": DURATION_S, **options})


def plan(**options: Any) -> TransferPlan:
    given: dict[str, Any] = {
        "robot": shipped(),
        "family": load_randomization("transfer"),
        "prior": made_up_prior(question(), legs=LEGS, worlds=16, model=MODEL),
        "worlds": WORLDS,
        "legs": LEGS,
        "optimizers": OPTIMIZERS,
        "runs": RUNS,
        "budget": BUDGET,
        "duration_s": DURATION_S,
    }
    return TransferPlan(**given | options)


def in_the_model(spec: LandscapeSpec, features: FloatArray) -> Landscape:
    """A landscape whose gaits walk as in a world of the made-up model."""
    points = spec.n_points
    at = np.arange(1, points + 1) / points * 10
    paths = np.empty((120, points, 2), dtype=np.float32)
    for row, path in enumerate(path_of(one) for one in features):
        for column in (0, 1):
            paths[row, :, column] = np.interp(at, np.arange(11), [0, *path[:, column]])
    numbers = np.zeros((120, len(NUMBERS)))
    numbers[:, NUMBERS.index("signed_m")] = features[:, FINAL]
    numbers[:, NUMBERS.index("distance_m")] = features[:, -2]
    numbers[:, NUMBERS.index("yaw_change_rad")] = features[:, -1]
    status = np.full(120, "ok", dtype="<U16")
    for code in FALLING:
        status[code - 1] = "fell"
        paths[code - 1, points // 2 :] = np.nan
    return Landscape(spec=spec, status=status, numbers=numbers, paths_m=paths)


def courses_of(found: "DataFrame", optimizer: str, place: int) -> list[Any]:
    """Runs of an optimizer in a landscape."""
    return list(where(found, optimizer=optimizer, place=place).itertuples())


@pytest.fixture(scope="module")
def landscapes() -> list[Landscape]:
    specs = plan().specs()
    worlds = MODEL.worlds(len(specs), seed=600)
    return [in_the_model(spec, world) for spec, world in zip(specs, worlds, strict=True)]


@pytest.fixture(scope="module")
def findings(landscapes: list[Landscape]) -> "DataFrame":
    return search_worlds(plan(), landscapes)


def test_no_world_has_a_value_in_common_with_one_of_a_prior() -> None:
    believed = load_randomization("randomised")
    known = PriorPlan(robot=shipped(), family=believed, worlds=100).specs()
    for key in believed.ranges:
        tried = {json.dumps(spec.world.model_dump()[key]) for spec in plan(worlds=100).specs()}
        assert not tried & {json.dumps(spec.world.model_dump()[key]) for spec in known}


def test_what_is_not_known_differs_from_world_to_world_and_needs_a_prior_for_that() -> None:
    unknown = plan_of(shipped(), duration_s=DURATION_S, failure=Failure(leg=5, kind="unknown"))
    prior = made_up_prior(PriorKey.of(shipped(), unknown))
    asked = plan(failure="unknown", prior=prior, worlds=20)
    asked.check()
    broken = [
        drawn_failure(spec.robot, trial.failures[0], trial.seed)
        for spec in asked.specs()
        for trial in [spec.trial(1)]
    ]
    assert len({str(one) for one in broken}) > 8
    assert {str(spec.trial(1).plan.failures[0]) for spec in asked.specs()} == {"unknown"}
    with pytest.raises(InputError, match="failure locked, not unknown"):
        plan(failure="unknown").check()


def test_a_course_is_what_the_landscape_has(landscapes: list[Landscape], findings: "DataFrame") -> None:
    for place, landscape in enumerate(landscapes):
        runs = [one for name in OPTIMIZERS for one in courses_of(findings, name, place)]
        for course in runs:
            trials = len(course.codes)
            assert course.best_m.shape == course.walked_s.shape == (BUDGET,)
            assert 1 <= trials <= BUDGET
            assert (np.diff(course.best_m) <= 0).all()
            assert (np.diff(course.walked_s[:trials]) > 0).all()
            assert (course.best_m[trials:] == course.best_m[trials - 1]).all()
            assert (course.walked_s[trials:] == course.walked_s[trials - 1]).all()
            if course.optimizer == EARLY:
                continue
            rows = course.codes - 1
            best = np.minimum.accumulate(np.where(landscape.valid[rows], landscape.final_m[rows], np.inf))
            worst = landscape.final_m[landscape.valid].max()
            np.testing.assert_array_equal(course.best_m[:trials], np.minimum(best, worst))
            seconds = np.where(landscape.valid[rows], DURATION_S, DURATION_S / 2)
            np.testing.assert_allclose(course.walked_s[:trials], np.cumsum(seconds))


def test_bayes_is_told_how_the_robot_stands_in_each_world(
    landscapes: list[Landscape], findings: "DataFrame", monkeypatch: pytest.MonkeyPatch
) -> None:
    sags_rad = MODEL.sags(len(landscapes), seed=600)
    by_place = {one.spec.title: sag for one, sag in zip(landscapes, sags_rad, strict=True)}
    monkeypatch.setattr(
        "hexctl.study.transfer.transfer_plan.deflection_of", lambda spec: by_place[spec.title]
    )
    blind = made_up_prior(question(), legs=LEGS, worlds=16, model=MODEL)
    stances = np.array([MODEL.sags(16, leg) for leg in LEGS])
    asked = plan(prior=replace(blind, sag_rad=stances), optimizers=("bayes", "random"))
    told = search_worlds(asked, landscapes)
    samples = {leg: samples_of(asked.prior, asked.robot, leg) for leg in LEGS}
    others = 0
    for place, landscape in enumerate(landscapes):
        (course,) = courses_of(told, "bayes", place)
        leg = landscape.spec.leg
        search = make_search(asked, landscape, "bayes", 0, samples[leg], sags_rad[place])
        alone = run_course(search, landscape, asked.budget)
        np.testing.assert_array_equal(course.codes, alone["codes"])
        others += not np.array_equal(course.codes, courses_of(findings, "bayes", place)[0].codes)
        for ours, before in zip(
            courses_of(told, "random", place), courses_of(findings, "random", place), strict=True
        ):
            np.testing.assert_array_equal(ours.codes, before.codes)
    assert others > 0, "what it was told changed no choice"


@pytest.mark.slow
def test_the_report_is_one_page_with_all_walks_beside_it(findings: "DataFrame", tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    assert plan().write(findings, tmp_path) == tmp_path / "transfer.html"
    assert {path.name for path in tmp_path.iterdir()} == {"transfer.html", "transfer.parquet"}
    text = (tmp_path / "transfer.html").read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>")
    for words in (*OPTIMIZERS, f"{WORLDS} worlds", f"{BUDGET} trials"):
        assert words in text
    table = pq.read_table(tmp_path / "transfer.parquet")
    assert table.num_rows == sum(map(len, findings["codes"]))
    assert {"world", "kind", "leg", "optimizer", "run", "trial", "code", "best_m", "walked_s"} == set(
        table.column_names
    )


@pytest.mark.parametrize(
    ("code", "cut_at", "status", "looked"),
    [
        (7, 200, "cut_short", [50, 100, 150, 200]),
        (7, 300, "ok", [50, 100, 150, 200, 250]),
        (FALLING[0], 1000, "fell", [50, 100]),
    ],
    ids=["cut short", "over anyway", "fell"],
)
def test_a_walk_is_what_a_session_would_have_seen(
    code: int, cut_at: int, status: str, looked: list[int], landscapes: list[Landscape]
) -> None:
    lengths: list[int] = []

    def enough(path_m: FloatArray) -> bool:
        lengths.append(len(path_m))
        return len(path_m) >= cut_at

    shown = walk_of(landscapes[0], code, enough)
    assert (shown.status, lengths) == (status, looked)
    assert shown.duration_s == pytest.approx(
        {"cut_short": 4.0, "ok": DURATION_S, "fell": DURATION_S / 2}[status]
    )
    assert (shown.yaw_change_rad is None) == (status == "cut_short")
    assert np.isfinite(shown.path_m).all()
    whole = walk_of(landscapes[0], 50)
    assert whole.path_m[-1, 1] == pytest.approx(landscapes[0].number("signed_m")[49], abs=1e-6)


def test_landscapes_without_a_valid_gait_are_left_out_and_counted(landscapes: list[Landscape]) -> None:
    asked = plan(optimizers=("random",))
    dead = replace(landscapes[0], status=np.full(120, "no_progress"))
    values = asked.numbers(search_worlds(asked, [dead, *landscapes[1:]]))
    assert (values["landscapes"], values["landscapes_without_valid_gait"]) == (len(landscapes) - 1, 1)
    with pytest.raises(RobotFaultError):
        search_worlds(asked, [dead])


SAME_WORLDS = {"family": load_randomization("transfer").model_dump(mode="json")}

PEXODS_LEG = made_up_prior(question("pexod"), legs=(1,), worlds=1)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"legs": (5, 9)}, "9"),
        ({"optimizers": ("nobody",)}, "nobody"),
        ({"duration_s": 12.0}, "duration"),
        ({"robot": shipped("pexod")}, "robot"),
        ({"prior": made_up_prior(question(self_rotation="front"), worlds=1)}, "self-rotation"),
        ({"prior": made_up_prior(question("phantomx"), worlds=1)}, "robot"),
        ({"prior": replace(made_up_prior(question(), worlds=1), origin=SAME_WORLDS)}, "prior"),
        ({"robot": shipped("pexod"), "prior": PEXODS_LEG, "legs": (1, 2)}, "legs"),
    ],
    ids=lambda value: value if isinstance(value, str) else "-",
)
def test_what_cannot_be_done_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        plan(**options).check()
    plan(robot=shipped("pexod"), prior=PEXODS_LEG, legs=(1, 6)).check()  # leg 6 is as leg 1

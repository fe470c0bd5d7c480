"""Jobs cover what tables and figures need, each piece once, and fail as the first that fails."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import pytest

from reconstruction.errors import InputError
from twin.paper import jobs
from twin.paper.colours import CALIBRATIONS
from twin.paper.figures import FIGURES
from twin.paper.jobs import Job, jobs_of, measure_ahead
from twin.paper.plan import CASES
from twin.paper.reproduction import Reproduction
from twin.paper.run import TABLES
from twin.study.workers import of_executor

TRIALS = 20


def test_every_trial_and_case_is_one_job():
    made = jobs_of(list(TABLES), list(FIGURES), TRIALS)
    trials = Counter(
        (name, number) for job in made if job.what == "fringes" for number in job.which[1]
        for name in [job.which[0]]
    )  # fmt: skip
    specimens = ("two_balls", "rods_a", "rods_b", "rods_c")
    assert trials == Counter((name, n) for name in specimens for n in range(TRIALS + 1))
    cases = Counter(
        (name, method)
        for job in made
        if job.what == "cases"
        for name in job.which[0]
        for method in job.which[1]
    )
    wanted = [(name, method) for names, methods in CASES for method in methods for name in names]
    assert cases == Counter(pair for pair in wanted if pair[1] != "photometric_stereo")
    colours = [job.which[0] for job in made if job.what == "colours"]
    assert sorted([*colours, 0]) == list(range(CALIBRATIONS))
    assert [job.which for job in made if job.what == "sensor"] == [(True, True)]


@pytest.mark.parametrize(
    ("tables", "figures", "kinds"),
    [
        (["hardness"], ["concept", "hardness"], set()),
        (["rods"], [], {"fringes", "budget"}),
        ([], ["rods"], {"cases", "sensor"}),
        (["spheres"], [], {"colours", "sensor", "fringes", "budget"}),
        (["completeness"], [], {"cases", "sensor"}),
        (["differences"], [], {"bare_nut"}),
    ],
)
def test_nothing_is_measured_that_nobody_asked_for(tables, figures, kinds):
    assert {job.what for job in jobs_of(tables, figures, 5)} == kinds


def test_the_rig_is_calibrated_before_what_rests_on_it(tmp_path, monkeypatch):
    happened = []
    monkeypatch.setattr(Reproduction, "rigs", lambda _: happened.append("rig"))
    monkeypatch.setattr(jobs, "do", lambda work, trials, settings, job: happened.append(job.what))
    asked = [Job("budget"), Job("fringes", rests_on_rig=True)]
    with ThreadPoolExecutor(1) as pool:
        run = Reproduction(tmp_path, 5)
        answer = measure_ahead(run, asked, of_executor(pool, 1), lambda: happened.append("drawn"))
    assert answer is None
    assert happened.index("rig") < happened.index("fringes")
    assert sorted(happened) == ["budget", "drawn", "fringes", "rig"]


def test_a_job_that_fails_is_told_as_it_would_be_alone(tmp_path, monkeypatch):
    def fail(*_):
        raise InputError("specimen: too large")

    monkeypatch.setattr(jobs, "do", fail)
    run = Reproduction(tmp_path, 5)
    with ThreadPoolExecutor(1) as pool, pytest.raises(InputError, match="specimen: too large"):
        measure_ahead(run, [Job("budget")], of_executor(pool, 1), dict)

"""The clinic: healthy patients raise no alarm, every fault is seen by its tests, and answers are scored as promised."""

from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
import pytest
from whole import few

from vislam_edu.course.clinic import clinic, clinic_tests, patients
from vislam_edu.course.clinic.clinic_tests import TESTS, bands, read
from vislam_edu.course.clinic.patients import FAULTS, HEALTHY, Build
from vislam_edu.stereo import StereoCamera
from vislam_edu.widgets import Explorer

# --- healthy and sick ---------------------------------------------------------------------------------------------

@pytest.mark.parametrize("build", ["nothing", "births first"])
def test_healthy_patients_raise_no_alarm(build):
    healthy = replace(Build(), **FAULTS[build].changes(1.0))
    for seed in few(1, range(10_000, 10_006)):
        for name in TESTS:
            readings = read(name, healthy, seed)
            assert all(bands()[name][key].holds(value) for key, value in readings.items()), (seed, name, readings)


@pytest.mark.parametrize("name", [name for name, fault in FAULTS.items() if fault.piece != HEALTHY])
def test_every_fault_is_separated_by_the_tests_that_its_case_lists(name):
    fault = FAULTS[name]
    assert fault.seen_by
    for severity in few(1, fault.severities):
        build = replace(Build(), **fault.changes(severity))
        for test in fault.seen_by:
            assert clinic.evident(test, lambda which, i, build=build: read(which, build, 30_000 + i)), severity


def test_the_stored_bands_are_those_of_healthy_runs():
    measured = clinic_tests.measure_bands(range(3), ("numbers", "H", "predict", "birth"))
    for name, readings in measured.items():
        stored = bands()[name]
        assert readings.keys() == stored.keys()
        for key, band in readings.items():
            spread = max(stored[key].sigma, clinic_tests.FLOOR / clinic_tests.WIDTH)
            assert abs(band.mean - stored[key].mean) < 4 * spread / 3**0.5, (name, key)
            assert stored[key].runs == clinic_tests.HEALTHY_SEEDS


def test_cross_terms_never_written_look_well_in_nis_and_lose_a_heading_that_nobody_measured():
    build = replace(Build(), **FAULTS["never"].changes(1.0))
    readings = read("standing still", build, 3)
    assert 3.3 < readings["NIS"] < 4.8
    assert readings["heading sigma, times that at the start"] < 0.7
    assert read("standing still", Build(), 3)["heading sigma, times that at the start"] > 0.9


# --- patients -----------------------------------------------------------------------------------------------------

def test_a_patient_is_drawn_by_a_keyed_hash_and_shows_no_fault():
    drawn = [patients.draw(5, number, 3, "secret") for number in range(1, 30)]
    again = [patients.draw(5, number, 3, "secret") for number in range(1, 30)]
    other = [patients.draw(5, number, 3, "another") for number in range(1, 30)]
    assert [one.faults for one in drawn] == [one.faults for one in again] != [one.faults for one in other]
    assert any(len(one.faults) == 2 for one in drawn)
    patient = clinic.Patient(5, 1, 3, "secret")
    shown = " ".join([repr(patient), str({key: value for key, value in vars(patient).items() if not callable(value)})])
    assert not any(f"'{name}'" in shown for name in FAULTS if name not in (*patients.PIECES, *TESTS))


def test_the_explorer_steps_a_patient_for_a_price_and_its_recording_does_not_say_what_was_planted():
    for number in range(1, 9):
        patient = clinic.Patient(7, number, 3)
        budget = patient.budget
        [history] = Explorer(islice(patient.steps(), 3), patient.recording).histories
        assert [shot.frame for shot in history.snapshots if shot.stage == 0] == [0, 1, 2]
        assert patient.budget == budget - 1
        assert patient.recording.history == ()
        assert type(patient.recording.camera) is StereoCamera
    watched = clinic.Patient(1, 2, 1)  # cross terms never written: after a few frames only blocks are left
    covariance = list(islice(watched.steps(), 4))[-1].posterior.covariance
    n = len(covariance) // 3
    blocks = covariance.reshape(n, 3, n, 3).swapaxes(1, 2)
    assert not np.any(blocks[:-2, :-2][~np.eye(n - 2, dtype=bool)])
    assert not np.any(blocks[:-2, -2:])


def test_the_first_three_patients_are_those_that_the_chapter_teaches():
    assert [patients.draw(1, number, 1).faults for number in (1, 2, 3)] == [(name,) for name in patients.FIRST]


def test_budget_hints_and_answers():
    patient = clinic.Patient(1, 1, 2)
    patient.order("H", "predict", "birth", "numbers")
    patient.order("H")  # a second time is free
    assert patient.budget == 2
    assert "order" in patient.hint()
    with pytest.raises(clinic.BudgetError, match="costs 1, and 0 is left"):
        patient.order("standing still")
    with pytest.raises(ValueError, match="no test"):
        patient.order("nothing of the kind")
    with pytest.raises(ValueError, match="pieces are"):
        patient.answer("the weather", "sign")
    patient.answer("pose Jacobian", "sign", "H")
    with pytest.raises(ValueError, match="has been answered"):
        patient.answer("pose Jacobian", "sign", "H")


def test_turning_sigma_up_is_no_cure():
    patient = clinic.Patient(1, 2, 1)  # cross terms never written
    patient.order("standing still")
    louder = {"noise": lambda noise: replace(noise, sigma_px=5 * noise.sigma_px)}
    score = patient.answer("covariance after the update", "missing", "standing still", louder)
    assert (score.piece, score.kind, score.evidence) == (2, 1, 3)
    assert score.cure <= 1


def test_the_right_answer_scores_ten():
    patient = clinic.Patient(1, 2, 1)
    patient.order("numbers", "standing still")
    assert patient.answer("covariance after the update", "missing", "standing still").total == 10


@cache
def read_once(name, seams, seed):
    """`read` for a build that stands at these seams: all cured patients are one."""
    return read(name, Build(*seams), seed)


@pytest.mark.parametrize("name", FAULTS)
def test_every_accepted_answer_scores_ten(name, monkeypatch):
    """That the listed tests are evidence is tested above; here they are taken for it."""
    fault = FAULTS[name]
    monkeypatch.setattr(clinic, "evident", lambda test, examine: test in fault.seen_by)
    monkeypatch.setattr(clinic, "read", lambda name, build, seed: read_once(name, tuple(vars(build).values()), seed))
    monkeypatch.setattr(clinic, "draw", lambda *_: patients.of((name,), np.random.default_rng(0), 40_000))
    for piece, kind in fault.answers:
        patient = clinic.Patient("anyone", 1, fault.levels[0])
        patient.order(*(fault.seen_by[:1] or ("H", "predict", "birth")))
        assert piece in patient.left
        score = patient.answer(piece, kind, fault.seen_by[:1])
        assert score.total == 10, score
        assert all("\n-" in diff or "\n+" in diff for diff in score.diffs)


def test_a_level_1_sheet_can_clear_the_noise_values():
    patient = clinic.Patient(1, 3, 1)  # healthy, built unusually
    patient.suspects = [*patient.suspects, "noise values"]
    patient.order("predict")
    assert "noise values" in patient.left
    patient.order("birth")
    assert "noise values" not in patient.left


def test_a_wrong_noise_value_is_never_cleared():
    for name, fault in FAULTS.items():
        if fault.piece == "noise values":
            for severity in fault.severities:
                build = replace(Build(), **fault.changes(severity))
                found = [bands()[test][key].holds(value) for test in clinic_tests.CLEARED_TOGETHER["noise values"]
                         for key, value in read(test, build, 40_000).items()]
                assert not all(found), (name, severity)

"""Bots in the clinic: one guesses, one knows three numbers, one orders the tests as they are taught."""

from dataclasses import replace
from functools import cache

import numpy as np
from whole import WHOLE, few

from vislam_edu.course.clinic import clinic, clinic_tests
from vislam_edu.course.clinic.clinic_tests import TESTS, bands, read
from vislam_edu.course.clinic.patients import FAULTS, HEALTHY, KINDS, Build

PATIENTS = few(8, [(student, number) for student in range(3) for number in range(1, 9)])  # 24


# --- bots -------------------------------------------------------------------------------------------------------

@cache
def atlas(test):
    """What each fault reads in a test, on a seed that no patient has: the experience of one who has seen all."""
    found = {}
    for name, fault in FAULTS.items():
        for severity in fault.severities if WHOLE else fault.severities[-1:]:
            build = replace(Build(), **fault.changes(severity))
            found[name, severity] = standardised(test, read(test, build, 500))
    return found


def standardised(test, readings):
    """How far readings are from healthy, in standard deviations, up to 8: beyond that the size says nothing."""
    return np.array([np.clip((np.log(value) - bands()[test][key].mean)
                             / max(bands()[test][key].sigma, clinic_tests.FLOOR / clinic_tests.WIDTH), -8, 8)
                     for key, value in readings.items()])


def guess(patient, rng):
    return str(rng.choice(patient.suspects)), str(rng.choice(list(KINDS))), ""


def by_experience(tests):
    """Orders tests until one is out of its band, and answers with the nearest fault that it has seen."""
    def bot(patient, rng):
        for name in tests:
            if TESTS[name].price <= patient.budget - (name != tests[0]):
                patient.order(name)
            if TESTS[name].bench and patient.abnormal(name):
                break
        ordered = tuple(name for name in tests if name in patient.readings)
        mine = np.concatenate([standardised(name, patient.readings[name]) for name in ordered])
        seen = {key: np.concatenate([atlas(name)[key] for name in ordered])
                for key in atlas("numbers") if FAULTS[key[0]].piece in patient.suspects}
        nearest = FAULTS[min(seen, key=lambda key: np.linalg.norm(seen[key] - mine))[0]]
        abnormal = [name for name in ordered if patient.abnormal(name)]
        if not abnormal and HEALTHY in patient.suspects:
            return HEALTHY, HEALTHY, ""
        return nearest.piece, nearest.kind, abnormal[-1] if abnormal else ""
    return bot


def mean_score(bot, levels=(1, 2)):
    rng, totals = np.random.default_rng(0), []
    for i, (student, number) in enumerate(PATIENTS):
        patient = clinic.Patient(f"bot {student}", number, levels[i % len(levels)])
        totals.append(patient.answer(*bot(patient, rng)).total)
    return np.mean(totals), np.std(totals) / len(totals) ** 0.5


def test_guessing_scores_under_2():
    assert mean_score(guess)[0] < 2


def test_three_numbers_score_under_5_and_a_half():
    assert mean_score(by_experience(("numbers",)))[0] < 5.5


def test_the_taught_sequence_scores_above_8():
    assert mean_score(by_experience(clinic_tests.TAUGHT))[0] > 8

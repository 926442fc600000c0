"""What a student reads at the first failure and at the second, on a quiet machine and on a busy one; common slips."""

import io
import re
import time
from contextlib import redirect_stdout
from types import SimpleNamespace

import numpy as np
import pytest
from blind_answers import read

from vislam_edu import se3
from vislam_edu.course.checks import mutants, running, transforms
from vislam_edu.course.checks.edit import plain_source
from vislam_edu.course.checks.verdict import RIGHT, WRONG, judge
from vislam_edu.course.exercises import EXERCISES, check, hint


def words(exercise):
    return {*re.findall(r"\w+", exercise.statement), *exercise.arguments, *exercise.outputs, exercise.name}


def quoted(text):
    return {word for quote in re.findall("`(.*?)`", text) for word in re.findall(r"\w+", quote)}


def zeros(exercise):
    """An answer of the right shapes, with zeros in them."""
    def zero(*arguments):
        result = exercise.reference(*arguments)
        if exercise.reading:
            return [tuple(np.zeros_like(part) for part in state) for state in result]
        return tuple(map(np.zeros_like, result)) if exercise.outputs else np.zeros_like(result)
    return zero


# --- nothing is given away --------------------------------------------------------------------------------

@pytest.mark.parametrize("name", EXERCISES)
def test_of_zeros_the_first_failure_says_that_they_are_zero_and_no_expression_of_an_answer(name):
    exercise = EXERCISES[name]
    verdict = judge(exercise, zeros(exercise))
    assert verdict.status == WRONG
    hints = " ".join(mistake.hint for mistake in exercise.mistakes)
    assert quoted(verdict.text) <= words(exercise) | quoted(hints)
    assert "zero on every input" in verdict.text or any(
        mistake.hint in verdict.text for mistake in exercise.mistakes) or any(
        words in verdict.text for words in ("LinAlgError", "look in filter_run"))
    for line in plain_source(exercise.reference).splitlines()[1:]:
        expression = line.split("=")[-1].strip().removeprefix("return ")
        assert len(expression) < 6 or expression.isidentifier() or expression not in verdict.text


@pytest.mark.parametrize("name", EXERCISES)
def test_words_for_a_change_quote_nothing_but_names_of_the_statement(name):
    exercise = EXERCISES[name]
    arguments = exercise.inputs()[0][1]
    for text in [*(mutant.words for mutant in mutants.of_exercise(exercise)),
                 *(text for text, _ in transforms.argument_changes(exercise.arguments, arguments))]:
        assert text.startswith("with")
        assert quoted(text) <= words(exercise) | {"cam_T_imu", "imu_T_cam", "K"}, text


def test_the_line_of_a_plain_answer_comes_at_the_second_failure_or_on_hint():
    def printed(function, *given):
        out = io.StringIO()
        with redirect_stdout(out):
            function(*given)
        return out.getvalue()

    def wrong(covariance, F, W):
        P = EXERCISES["predict_joint"].reference(covariance, F, W)
        P[-6:, -6:] -= 2 * W
        return P

    line = re.compile(r"^  - .*\n  \+ .*W$", re.MULTILINE)
    first = printed(check.predict_joint, wrong)
    assert "Your result is what one gets" in first
    assert not line.search(first)
    assert line.search(printed(hint, "predict_joint"))
    assert line.search(printed(check.predict_joint, wrong))
    printed(check.predict_joint, EXERCISES["predict_joint"].reference)
    assert not line.search(printed(check.predict_joint, wrong))


# --- a busy machine ---------------------------------------------------------------------------------------

def test_a_verdict_is_the_same_where_the_clock_on_the_wall_runs_20_times_faster(monkeypatch):
    answers = read()[::70]
    quiet = [judge(EXERCISES[answer.exercise], answer.function()) for answer in answers]
    for name in ("time", "monotonic", "perf_counter"):
        clock = getattr(time, name)
        monkeypatch.setattr(time, name, lambda clock=clock: 20 * clock())
    busy = [judge(EXERCISES[answer.exercise], answer.function()) for answer in answers]
    assert [(one.text, one.more) for one in quiet] == [(one.text, one.more) for one in busy]


def test_who_waits_is_stopped_by_the_clock_on_the_wall(monkeypatch):
    def waits(omega):
        while True:
            time.sleep(0.01)

    monkeypatch.setattr(running, "_PATIENCE", 0.1)
    verdict = judge(EXERCISES["so3_hat"], waits, limit=3.0)
    assert "does it wait for something?" in verdict.text


# --- common slips -----------------------------------------------------------------------------------------

def in_another_order(W, F, covariance):
    return EXERCISES["predict_joint"].reference(covariance, F, W)


tau = 0.1


def with_a_global(sigma_v, sigma_omega, dt):
    return tau**2 * np.diag([sigma_v**2] * 3 + [sigma_omega**2] * 3)


PHI = np.array([0.1, 0.2, 0.3])


def of_a_global(phi):
    return se3.so3_exp(PHI)


def at_random(omega):
    return se3.so3_hat(omega) + np.random.default_rng().normal(size=(3, 3))


seen: list = []


def remembers(omega):
    seen.append(omega)
    return se3.so3_hat(np.sum(seen, axis=0))


def cut(omega):
    x, y, z = omega
    matrix = np.zeros((3, 3), dtype=int)
    matrix[0, 1], matrix[0, 2], matrix[1, 2] = -z, y, -x
    matrix[1, 0], matrix[2, 0], matrix[2, 1] = z, -y, x
    return matrix


def cut_on_the_way(T):
    A = np.zeros((6, 6), dtype=int)
    A[:3, :3], A[:3, 3:], A[3:, 3:] = T[:3, :3], se3.so3_hat(T[:3, 3]) @ T[:3, :3], T[:3, :3]
    return A


def with_something_else(phi):
    return se3.so3_exp(phi), np.linalg.norm(phi)


def twice(phi):
    return se3.so3_exp(phi), se3.so3_exp(-phi)


def typed(omega):
    return se3.so3_hat(float(input("x: ")) * omega)


def raises(omega):
    angle = np.linalg.norm(omega)
    return angle @ omega


def three(omega, angle, axis):
    return se3.so3_hat(omega)


@pytest.mark.parametrize(("name", "answer", "said"), [
    ("predict_joint", in_another_order, "takes its arguments in another order, (W, F, covariance). Write def predict"),
    ("process_noise", with_a_global, "never uses `dt`; it reads `tau`, which is defined outside it."),
    ("so3_exp", of_a_global, "the same on every input: it does not depend on the arguments.\n"
                             "Your function never uses `phi`; it reads `PHI`"),
    ("so3_hat", at_random, "Two calls with the same arguments gave different results"),
    ("so3_hat", remembers, "keeps something from one call to the next"),
    ("so3_hat", cut, "an array of integers (dtype=int) cuts off"),
    ("adjoint", cut_on_the_way, "an array of integers (dtype=int) cuts off"),
    ("so3_exp", with_something_else, "must be one array, and it is a tuple of 2"),
    ("so3_exp", twice, "Are these 2 results, of which only one is asked for?"),
    ("so3_hat", typed, "RuntimeError: input() waits for somebody who types"),
    ("so3_hat", raises, "in raises:  return angle @ omega\n  ValueError: matmul"),
    ("so3_hat", three, "Write def so3_hat(omega), as in the stub."),
], ids=lambda value: getattr(value, "__name__", ""))
def test_a_slip_gets_a_useful_word(name, answer, said):
    verdict = judge(EXERCISES[name], answer)
    assert verdict.status == WRONG
    assert said in verdict.text


def test_an_argument_that_the_reference_does_not_use_either_is_not_asked_for():
    exercise = EXERCISES["so3_hat"]
    assert "never uses" not in judge(exercise, lambda omega: 2 * se3.so3_hat(omega)).text


def test_an_array_that_is_yielded_and_then_changed_is_said():
    def run(drive, noise):
        kept = np.eye(4)
        for T, *others in EXERCISES["filter_run"].reference(drive, noise):
            kept[:] = T
            yield kept, *others

    assert "changes an array after it has yielded it" in judge(EXERCISES["filter_run"], run).text


def test_a_tuple_among_the_arguments_that_is_changed_is_said():
    def frame(state, ids, pixels, camera, noise):
        result = EXERCISES["filter_frame"].reference(state, ids, pixels, camera, noise)
        state[3][:] = 0
        return result

    assert "changes its argument state" in judge(EXERCISES["filter_frame"], frame).text


def test_lines_that_would_print_alike_show_more_digits():
    verdict = judge(EXERCISES["so3_hat"], lambda omega: se3.so3_hat(omega) * (1 + 1e-6))
    _, came, should = re.split("came out\n|should be\n", verdict.text)
    assert came.splitlines()[:3] != should.splitlines()[:3]


def test_a_students_file_beside_the_package_is_theirs():
    theirs = f"{running._PACKAGE}_notebooks/mine.py"
    frames = [SimpleNamespace(filename=name) for name in (theirs, f"{running._PACKAGE}/se3.py")]
    assert [frame.filename for frame in frames
            if not frame.filename.startswith(tuple(running._NOT_THEIRS))] == [theirs]


def test_what_reads_well_is_right_still():
    assert judge(EXERCISES["so3_exp"], lambda phi: se3.so3_exp(phi).tolist()).status == RIGHT

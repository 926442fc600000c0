"""The checks of the exercises: right answers pass, wrong ones are named, and nothing an answer does breaks a check."""

import io
import threading
import time
import warnings
from contextlib import redirect_stdout
from functools import cache

import numpy as np
import pytest
from whole import WHOLE, few

from vislam_edu import se3
from vislam_edu.course.checks import explain, running
from vislam_edu.course.checks.exercise import exercise as make_exercise
from vislam_edu.course.checks.verdict import NOT_WRITTEN, RIGHT, WRONG, judge
from vislam_edu.course.exercises import EXERCISES, check, hint, solution

PIECES = [(name, i) for name, exercise in EXERCISES.items() for i in range(len(exercise.mistakes))]


@cache
def judged(name, i):
    """The verdict on a piece of the museum, and the seconds of processor time that it took."""
    start = time.process_time()
    verdict = judge(EXERCISES[name], EXERCISES[name].mistakes[i].function)
    return verdict, time.process_time() - start


def printed(function, *arguments):
    out = io.StringIO()
    with redirect_stdout(out):
        function(*arguments)
    return out.getvalue()


# --- right answers ----------------------------------------------------------------------------------------


def test_exercises_come_in_the_order_of_the_chapters_and_say_whose_folder_they_are_in():
    assert len(EXERCISES) >= 20
    assert [exercise.chapter for exercise in EXERCISES.values()] == sorted(e.chapter for e in EXERCISES.values())
    for name, exercise in EXERCISES.items():
        assert exercise.reference.__module__.endswith(f".ch{exercise.chapter:02d}.exercises"), name


@pytest.mark.parametrize("name", EXERCISES)
def test_the_reference_is_right_and_quick(name):
    start = time.process_time()
    verdict = judge(EXERCISES[name], EXERCISES[name].reference)
    assert verdict.status == RIGHT, verdict.text
    assert time.process_time() - start < 1


@pytest.mark.parametrize("name", ["so3_exp", "se3_exp", "adjoint", "project", "pose_jacobian", "kalman_update"])
def test_float32_is_right_with_a_remark(name):
    def in_float32(*arguments):
        result = EXERCISES[name].reference(*arguments)
        return tuple(map(np.float32, result)) if isinstance(result, tuple) else np.float32(result)

    verdict = judge(EXERCISES[name], in_float32)
    assert verdict.status == RIGHT
    assert "64 bits" in verdict.text
    assert "64 bits" not in judge(EXERCISES[name], EXERCISES[name].reference).text


# --- the museum -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "i"), PIECES)
def test_every_piece_is_recognised_with_its_own_hint(name, i, monkeypatch):
    if i >= 1 and not WHOLE:  # without the search for other words, which takes most of the time
        monkeypatch.setattr(explain, "CANDIDATES", 0)
    mistake = EXERCISES[name].mistakes[i]
    verdict, seconds = judged(name, i)
    assert seconds < 2
    assert verdict.status == WRONG
    assert verdict.mistake == mistake.name
    assert f"Most likely: {mistake.name}. {mistake.hint}" in verdict.text


def test_names_and_hints_tell_pieces_apart():
    for exercise in EXERCISES.values():
        assert len(exercise.mistakes) >= 3, f"{exercise.name}: three slips or mistakes at least"
        assert len({m.name for m in exercise.mistakes}) == len({m.hint for m in exercise.mistakes}) == \
            len(exercise.mistakes)


def so3_exp_by_hand(phi):
    """Written otherwise than the museum's piece, with the same mistake."""
    import math

    x, y, z = phi.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    axis = [x / angle, y / angle, z / angle]
    K = np.cross(axis, np.eye(3)).T
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


def test_a_mistake_is_recognised_in_other_words():
    verdict = judge(EXERCISES["so3_exp"], so3_exp_by_hand)
    assert verdict.mistake == "no small-angle branch"
    assert "ZeroDivisionError: float division by zero" in verdict.text  # what Python's own numbers do


def test_a_mistake_that_explains_a_part_is_offered_as_a_guess():
    def two_mistakes(xi):
        return se3.exp(np.roll(xi, 3)) if xi[5] <= 0 else np.zeros((4, 4))

    text = judge(EXERCISES["se3_exp"], two_mistakes).text
    assert "Perhaps: rotation and translation swapped." in text
    assert "Most likely" not in text


def test_a_mistake_that_does_not_explain_the_input_shown_is_no_guess():
    first = EXERCISES["se3_exp"].inputs()[0][1][0]

    def mostly_another(xi):
        return np.zeros((4, 4)) if np.array_equal(xi, first) else se3.exp(np.roll(xi, 3))

    verdict = judge(EXERCISES["se3_exp"], mostly_another)
    assert "on input 1 of" in verdict.text
    assert "Perhaps" not in verdict.text


@pytest.mark.parametrize(("name", "first_order"), [
    ("so3_exp", lambda phi: np.eye(3) + se3.so3_hat(phi) if np.linalg.norm(phi) < 0.2 else se3.so3_exp(phi)),
    ("se3_exp", lambda xi: np.eye(4) + se3.hat(xi) if np.linalg.norm(xi[3:]) < 0.2 else se3.exp(xi)),
])
def test_first_order_is_not_enough_for_small_angles(name, first_order):
    """A step of an IMU turns by a hundredth of a radian, so there must be inputs of that size."""
    assert judge(EXERCISES[name], first_order).status == WRONG


def test_an_unknown_mistake_gets_numbers_and_no_guess():
    verdict = judge(EXERCISES["so3_hat"], lambda omega: np.outer(omega, omega) / 7)
    assert verdict.mistake == ""
    assert "Perhaps" not in verdict.text
    assert "largest difference" in verdict.text
    assert "rank 1 where 2 is right" in verdict.text


# --- not written yet --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EXERCISES)
def test_the_stub_is_not_written_yet(name):
    scope = {}
    exec(EXERCISES[name].stub, scope)
    verdict = judge(EXERCISES[name], scope[name])
    assert (verdict.status, verdict.text) == (NOT_WRITTEN, f"{name}: not written yet")


@pytest.mark.parametrize("blank", [None, ..., NotImplemented], ids=["None", "dots", "NotImplemented"])
def test_returning_nothing_is_not_written_yet(blank):
    assert judge(EXERCISES["so3_hat"], lambda omega: blank).status == NOT_WRITTEN


def test_a_function_that_calls_a_stub_says_which():
    scope = {"np": np}
    exec(EXERCISES["so3_hat"].stub + "\n\ndef so3_exp(phi):\n    return np.eye(3) + so3_hat(phi)\n", scope)
    verdict = judge(EXERCISES["so3_exp"], scope["so3_exp"])
    assert (verdict.status, verdict.text) == (NOT_WRITTEN, "so3_exp: it calls so3_hat, which is not written yet")


def test_the_stub_states_the_task_and_the_tolerance():
    for exercise in EXERCISES.values():
        assert " ".join(exercise.statement.split()) in " ".join(exercise.stub.split())
        assert max(map(len, exercise.stub.splitlines())) <= 100
        assert "Checked to 1e-" in exercise.stub
        assert "Returns" in exercise.stub
        assert max(map(len, exercise.stub.splitlines())) <= 120


# --- what answers do --------------------------------------------------------------------------------------


def test_an_exception_is_told_in_the_students_own_lines():
    def helper(omega):
        return np.cross(omega, np.zeros(4))

    def answer(omega):
        return helper(omega)

    text = judge(EXERCISES["so3_hat"], answer).text
    assert "in answer:  return helper(omega)" in text
    assert "in helper:  return np.cross(omega, np.zeros(4))" in text
    assert "ValueError: incompatible dimensions" in text
    assert "running.py" not in text
    assert ".py" not in text


def test_ending_the_program_is_an_exception_like_any_other():
    def answer(omega):
        raise SystemExit(3)

    assert "SystemExit: 3" in judge(EXERCISES["so3_hat"], answer).text


def test_an_address_does_not_get_into_the_text():
    def answer(omega):
        raise ValueError(f"bad {object()!r}")

    assert "object at 0x...>" in judge(EXERCISES["so3_hat"], answer).text


def threads():
    return {thread for thread in threading.enumerate() if thread.daemon}


@pytest.mark.parametrize("stubborn", [False, True])
def test_an_endless_loop_is_stopped_and_said(stubborn):
    def endless(omega):
        while True:
            try:
                sum(range(1000))
            except Exception:
                if not stubborn:
                    raise

    before = threads()
    start = time.monotonic()
    verdict = judge(EXERCISES["so3_hat"], endless, limit=0.2)
    assert time.monotonic() - start < 5
    assert verdict.status == WRONG
    assert "still no answer after 0.2 s" in verdict.text
    assert "restart" not in verdict.text
    assert threads() == before


def test_what_cannot_be_stopped_is_said_too():
    def asleep(omega):
        time.sleep(3)
        return se3.so3_hat(omega)

    assert "restart the kernel" in judge(EXERCISES["so3_hat"], asleep, limit=0.05).text


def test_changing_an_argument_is_told_and_does_no_harm():
    def answer(omega):
        omega *= 2
        return se3.so3_hat(omega / 2)

    verdict = judge(EXERCISES["so3_hat"], answer)
    assert verdict.status == WRONG
    assert "changes its argument omega" in verdict.text
    assert "Perhaps" not in verdict.text
    assert judge(EXERCISES["so3_hat"], se3.so3_hat).right


def test_the_students_arrays_are_never_handed_out():
    kept = []

    def answer(omega):
        kept.append(omega)
        return se3.so3_hat(omega)

    assert judge(EXERCISES["so3_hat"], answer).right
    for array in kept:
        array[:] = np.nan
    assert judge(EXERCISES["so3_hat"], answer).right


def test_warnings_stay_silent(recwarn):
    def answer(phi):
        warnings.warn("a path that differs from run to run", stacklevel=1)
        return se3.so3_exp(phi) + np.zeros(1) / np.zeros(1)

    assert "not a finite number" in judge(EXERCISES["so3_exp"], answer).text
    assert not recwarn.list


@pytest.mark.parametrize(("answer", "words"), [
    (lambda K, uv: np.linalg.solve(K, np.append(uv, 1))[:, None],
     "has shape (3, 1); it should be (3,). The numbers are right: a column"),
    (lambda K, uv: uv[0] * np.ones((3, 1)) * np.ones(3), "has shape (3, 3); it should be (3,). Has a column"),
    (lambda K, uv: "bearing", "must be an array of real numbers"),
    (lambda K, uv: [[1, 2], [3]], "rows have different lengths"),
    (lambda K, uv: 1j * np.ones(3), "must be an array of real numbers"),
    (lambda K: K, "takes 1 positional argument but 2 were given"),
], ids=["column", "table", "text", "ragged", "complex", "arguments"])
def test_odd_results_are_told_in_words(answer, words):
    verdict = judge(EXERCISES["bearing"], answer)
    assert verdict.status == WRONG
    assert words in verdict.text


class Exits:
    def __array__(self, *_, **__):
        raise SystemExit


def stops(omega):
    raise running._Stop


@pytest.mark.parametrize("answer", [lambda omega: [[10**5000] * 3] * 3, lambda omega: Exits(), stops])
def test_an_answer_whose_result_cannot_be_read_is_wrong(answer):
    assert judge(EXERCISES["so3_hat"], answer).status == WRONG


def test_a_transposed_result_is_told():
    text = judge(EXERCISES["odot"], lambda point: se3.odot(point).T).text
    assert "shape (6, 4); it should be (4, 6). The numbers are right, but transposed." in text


def test_a_missing_result_is_told():
    text = judge(EXERCISES["chi2_band"], lambda dof, runs, probability: 3.0).text
    assert "must return 2 results, low, high; it returned one float" in text


def test_giving_the_result_instead_of_the_function_is_told():
    assert "without calling it" in judge(EXERCISES["so3_hat"], se3.so3_hat(np.ones(3))).text


def test_what_the_mask_excludes_does_not_matter():
    def with_anything(K, baseline, pixels):
        points, ok = EXERCISES["triangulate"].reference(K, baseline, pixels)
        points[~ok] = 1e9
        return points, ok

    assert judge(EXERCISES["triangulate"], with_anything).right


def test_an_error_just_above_the_tolerance_is_found():
    def off_by(size):
        return judge(EXERCISES["so3_exp"], lambda phi: se3.so3_exp(phi) + size).right

    assert off_by(0.5e-8)
    assert not off_by(2e-8)


# --- check, hint, solution --------------------------------------------------------------------------------


def test_a_check_prints_and_remembers():
    assert printed(check.so3_hat, se3.so3_hat) == \
        "so3_hat: right, on 7 inputs (5 random; x axis; [1, 2, 3]), to 1e-8 of the largest entry\n"
    with pytest.raises(ValueError, match="has not found a failing input"):
        _ = check.so3_hat.failing
    text = printed(check.so3_hat, lambda omega: se3.so3_hat(-omega))
    first, entries = check.so3_hat.last, EXERCISES["so3_hat"].inputs()[0][1][0]
    assert text.startswith("so3_hat: wrong, on input 1 of 7 (random)\n  omega = [")
    assert "Most likely: signs transposed. This is the transpose, -omega^: it gives cross(b, a)." in text
    assert "The same numbers come out with the sign of" in " ".join(text.split())
    assert text.endswith("To try this input: so3_hat(*check.so3_hat.failing)\n"
                         "A second failure, or hint('so3_hat'), shows where to look.\n")
    assert first.status == WRONG
    assert check.so3_hat.last.mistake == "signs transposed"
    np.testing.assert_array_equal(check.so3_hat.failing[0], entries)


@pytest.mark.parametrize("name", [name for name in EXERCISES if not EXERCISES[name].reading])
def test_texts_are_the_same_each_time_and_show_no_rounding(name):
    for i, mistake in few(1, enumerate(EXERCISES[name].mistakes)):
        def jittered(*arguments, mistake=mistake):
            result = mistake.function(*arguments)
            parts = result if isinstance(result, tuple) else (result,)
            parts = [part if np.asarray(part).dtype == bool else part * (1 + 1e-15) +
                     1e-16 * np.abs(part)[np.isfinite(part)].max(initial=0) for part in map(np.asarray, parts)]
            return tuple(parts) if isinstance(result, tuple) else parts[0]

        jittered_text = judge(EXERCISES[name], jittered).text
        if "LinAlgError" not in jittered_text:  # an error shows the line it comes from
            assert jittered_text == judged(name, i)[0].text


def test_the_namespace_lists_the_exercises_and_suggests_names():
    assert dir(check) == sorted(EXERCISES)
    assert check.so3_hat is check.so3_hat
    with pytest.raises(AttributeError, match="did you mean se3_exp"):
        _ = check.se3_epx
    with pytest.raises(ValueError, match="did you mean se3_exp"):
        hint("se3_epx")


@pytest.mark.parametrize("name", EXERCISES)
def test_hints_are_graded_and_the_solution_is_the_packages(name):
    exercise = EXERCISES[name]
    assert len(exercise.hints) >= 2
    told = [" ".join(printed(hint, name, level).split()) for level in (1, 2)]  # long lines are broken
    assert told[0].startswith(f"{name}, hint 1 of {len(exercise.hints)}: {exercise.hints[0]}")
    assert exercise.hints[1] in told[1]
    with pytest.raises(ValueError, match=f"has hints 1 to {len(exercise.hints)}"):
        hint(name, len(exercise.hints) + 1)
    shown = printed(solution, name)
    assert shown.startswith(f"def {name}(")
    assert all(f"def {function.__name__}(" in shown for function in exercise.shows)
    assert "@exercise" not in shown


def test_a_check_raises_only_under_nbgrader(monkeypatch):
    printed(check.so3_hat, lambda omega: None)
    monkeypatch.setenv("NBGRADER_EXECUTION", "validate")
    printed(check.so3_hat, se3.so3_hat)
    with pytest.raises(AssertionError, match="so3_hat: not written yet"), redirect_stdout(io.StringIO()):
        check.so3_hat(lambda omega: None)


def test_two_exercises_cannot_share_a_name():
    with pytest.raises(ValueError, match="two exercises called so3_hat"):
        make_exercise(chapter=1, cases=lambda rng: [], hints=[], shows=[])(EXERCISES["so3_hat"].reference)


def test_the_inputs_are_the_same_each_time():
    for exercise in EXERCISES.values():
        for (_, first), (_, second) in zip(exercise.inputs(), exercise.inputs(), strict=True):
            for a, b in zip(first, second, strict=True):
                if isinstance(a, np.ndarray):
                    np.testing.assert_array_equal(a, b)
                    assert a is not b


def test_the_limit_leaves_room_for_a_busy_machine():
    assert running.LIMIT >= 2


def test_where_no_thread_can_start_the_checks_of_chapter_1_work_without_a_time_limit(monkeypatch):
    def start(_):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    for exercise in (one for one in EXERCISES.values() if one.chapter == 1):
        assert judge(exercise, exercise.reference).right
        verdict = judge(exercise, exercise.mistakes[0].function)
        assert verdict.status == WRONG
        assert verdict.mistake == exercise.mistakes[0].name

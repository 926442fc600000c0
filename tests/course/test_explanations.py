"""Wrong answers that nobody had in mind are explained too: a blind set, and the museum with each piece left out.

VISLAM_EDU_WHOLE=1 takes the whole of both, which is a matter of minutes; otherwise every twentieth answer is taken.
"""

import dataclasses
import statistics
import subprocess
import sys
import time
from collections import Counter

import numpy as np
import pytest
from blind_answers import read
from whole import WHOLE, few

from vislam_edu import se3
from vislam_edu.course.checks import explain, mutants, surroundings
from vislam_edu.course.checks.edit import wrong_source
from vislam_edu.course.checks.verdict import NOT_WRITTEN, RIGHT, WRONG, judge
from vislam_edu.course.exercises import EXERCISES

BLIND = read()
EVERY = 1 if WHOLE else 20


def of_another_seed(exercise):
    """The same exercise with other inputs: an explanation that is true explains these as well."""
    return dataclasses.replace(exercise, cases=lambda rng: exercise.cases(np.random.default_rng(rng.integers(2**32))))


def located(verdict):
    return verdict.located or "has shape" in verdict.text or "it must return" in verdict.text


def kind(exercise, function):
    verdict = judge(exercise, function)
    if not verdict.mistake:
        return "localised" if located(verdict) else "generic"
    other = judge(of_another_seed(exercise), function)
    return "named" if (verdict.mistake, verdict.more) == (other.mistake, other.more) else "misnamed"


def test_the_blind_set_is_large_enough():
    counts = Counter((answer.exercise, answer.cause == "") for answer in BLIND)
    for name, exercise in EXERCISES.items():
        right, wrong = counts[name, True], counts[name, False]
        assert right >= (3 if exercise.chapter <= 12 else 2), f"right answers to {name} in blind_answers/: {right}"
        assert wrong >= 10 or name.startswith("filter_"), f"wrong answers to {name} in blind_answers/: {wrong}"


def test_right_blind_answers_are_right_and_quick():
    times = []
    for answer in BLIND:
        if not answer.cause:
            start = time.process_time()
            verdict = judge(EXERCISES[answer.exercise], answer.function())
            times.append(time.process_time() - start)
            assert verdict.status == RIGHT, f"blind answer {answer.body!r}: {verdict.text}"
    assert statistics.median(times) < 0.1


@pytest.mark.parametrize("name", EXERCISES)
def test_wrong_blind_answers_are_refused(name, monkeypatch):
    monkeypatch.setattr(explain, "CANDIDATES", 0)  # without the search for words, which takes most of the time
    for answer in few(1, (answer for answer in BLIND if answer.exercise == name and answer.cause)):
        verdict = judge(EXERCISES[name], answer.function())
        assert verdict.status == WRONG, f"{name}, {answer.cause!r}: {verdict.text}"


def test_most_wrong_blind_answers_are_named():
    answers = [answer for answer in BLIND if answer.cause][::EVERY]
    kinds = [kind(EXERCISES[answer.exercise], answer.function()) for answer in answers]
    share = {name: count / len(kinds) for name, count in Counter(kinds).items()}
    print(Counter(kinds), [a.exercise + ": " + a.cause for a, k in zip(answers, kinds) if k == "misnamed"])
    assert share["named"] >= 0.7
    assert share["named"] + share["localised"] >= 0.9
    assert share.get("misnamed", 0.0) <= 0.01


def test_pieces_of_the_museum_are_described_without_the_museum():
    kinds = Counter()
    museum = [(exercise, piece) for exercise in EXERCISES.values() for piece in exercise.mistakes]
    for exercise, piece in museum[::EVERY]:
        others = [other for other in exercise.mistakes if other is not piece]
        verdict = judge(dataclasses.replace(exercise, mistakes=others), piece.function)
        kinds["named" if verdict.mistake and "Perhaps" not in verdict.text else
              "localised" if located(verdict) else "generic"] += 1
    print(kinds)
    assert kinds["named"] >= 0.55 * kinds.total()  # many a piece is there because the search finds no words for it
    assert kinds["generic"] <= 0.1 * kinds.total()


@pytest.mark.parametrize("name", EXERCISES)
def test_plain_answers_are_right_and_their_mutants_come_to_an_end(name):
    exercise = EXERCISES[name]
    for answer in exercise.answers:
        assert judge(exercise, answer).right
    for mistake in few(1, exercise.mistakes):
        assert mutants.of_source(wrong_source(mistake.base, *mistake.edits), mistake.base, exercise.statement)
    found = mutants.of_exercise(exercise)
    assert len(found) > 20 or name in ("filter_frame", "filter_run"), f"the plain answer has {len(found)} mutants"
    start = time.process_time()
    with np.errstate(all="ignore"):
        for mutant in found[::1 if WHOLE else 4]:
            try:
                mutant.function(*exercise.inputs()[0][1])
            except Exception:  # a mutant may fail in any way; it must not hang
                continue
    assert time.process_time() - start < 20


def test_explanations_that_fit_alike_are_all_listed():
    def answer(camera, world_T_imu, covariance, landmarks, pixels, sigma_px):
        mirrored = 2 * camera.observe(world_T_imu, landmarks)[0] - pixels
        return EXERCISES["pose_update"].reference(camera, world_T_imu, covariance, landmarks, mirrored, sigma_px)

    text = judge(EXERCISES["pose_update"], answer).text
    assert "residual of the wrong sign" in text
    assert "The same numbers come out with a difference taken the other way round" in text


def test_two_mistakes_in_two_results_are_both_named():
    def answer(covariance, H, V, residual):
        delta, P = EXERCISES["kalman_update"].reference(covariance, H, V, residual)
        return -delta, P.T @ np.triu(np.ones_like(P)) * 0 + np.diag(np.diag(P))

    text = judge(EXERCISES["kalman_update"], answer).text
    assert "reversed (in delta) and with only the diagonal of the result (in covariance)." in text


def test_an_error_is_explained_by_the_same_error_only():
    def answer(T, landmarks, P, rows, pixels, camera, noise):  # `observe` returns two arrays
        return np.zeros(4) + camera.observe(T, landmarks[rows[0]])

    text = judge(EXERCISES["filter_update"], answer).text
    assert "ValueError" in text
    assert "Your result is what one gets" not in text


# --- beginners' slips -------------------------------------------------------------------------------------

def forgotten_return(omega):
    matrix = se3.so3_hat(omega)  # noqa: F841


def code_below_the_stub(omega):
    raise NotImplementedError
    return se3.so3_hat(omega)


async def coroutine(omega):
    return se3.so3_hat(omega)


def generator(omega):
    yield from se3.so3_hat(omega)


@pytest.mark.parametrize(("answer", "status", "words"), [
    (forgotten_return, WRONG, "is `return` missing?"),
    (code_below_the_stub, NOT_WRITTEN, "the line `raise NotImplementedError` is still there"),
    (coroutine, WRONG, "write def, not async def"),
    (generator, WRONG, "wrap it in list(...)"),
    (lambda omega: se3.so3_hat(omega) + 0j, RIGHT, "take .real"),
    (lambda omega: se3.so3_hat(omega).astype(object), RIGHT, "array of Python objects"),
], ids=["return", "raise", "async", "yield", "complex", "object"])
def test_slips_are_said(answer, status, words):
    verdict = judge(EXERCISES["so3_hat"], answer)
    assert verdict.status == status
    assert words in verdict.text


def test_one_array_is_taken_apart():
    verdict = judge(EXERCISES["chi2_band"], lambda *given: np.array(EXERCISES["chi2_band"].reference(*given)))
    assert verdict.right
    assert "it was taken apart" in verdict.text


# --- hostile answers --------------------------------------------------------------------------------------

def endless_print(omega):
    while True:
        print("x" * 100)


def recursion(omega):
    import sys
    sys.setrecursionlimit(10**9)
    return recursion(omega)


def huge(omega):
    return [np.ones(10**9) for _ in range(10)]


def leave(omega):
    raise SystemExit


def rebind(omega):
    np.abs = se3.so3_hat = len
    return omega


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # the exception that stops a thread
@pytest.mark.parametrize("answer", [endless_print, recursion, huge, leave, rebind])
def test_the_next_check_is_as_if_a_hostile_answer_had_never_run(answer, capsys):
    absolute = np.abs
    verdict = judge(EXERCISES["so3_hat"], answer, limit=1.0)
    assert verdict.status == WRONG
    assert len(capsys.readouterr().out) < 3000
    assert np.abs is absolute
    assert ("np.abs" in verdict.text) == (answer is rebind)
    assert judge(EXERCISES["so3_hat"], se3.so3_hat).right
    assert sys.getrecursionlimit() < 10**5


def test_a_recursion_that_catches_everything_does_not_end_python(tmp_path):
    """It cannot be stopped. Python aborts when the limit is lowered under a thread that is deep in its calls."""
    script = tmp_path / "kernel.py"
    script.write_text("""
import sys, time
from vislam_edu.course.exercises import EXERCISES
from vislam_edu.course.checks.verdict import judge

def answer(omega):
    sys.setrecursionlimit(10**9)
    try:
        return answer(omega)
    except:
        return answer(omega)

print(judge(EXERCISES["so3_hat"], answer, limit=0.5).text)
time.sleep(0.5)
""")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "could not be stopped" in done.stdout


# --- pictures ---------------------------------------------------------------------------------------------

@pytest.mark.parametrize(("name", "title"), [("joint_jacobian", "wrong entries are framed"),
                                             ("predict_covariance", "95 % ellipses"), ("dead_reckon", "from above")])
def test_a_wrong_result_has_a_picture(name, title):
    verdict = judge(EXERCISES[name], EXERCISES[name].mistakes[0].function)
    assert title in verdict.picture.figure().axes[0].get_title(loc="left").replace("\N{NO-BREAK SPACE}", " ")
    data, metadata = verdict.picture._repr_mimebundle_()
    assert data["text/plain"].startswith("picture of")
    assert metadata["image/png"]["alt"]
    assert judge(EXERCISES[name], EXERCISES[name].reference).picture is None


def test_what_a_kernel_sets_itself_is_not_the_students(monkeypatch):
    surroundings.remember()
    monkeypatch.setattr("builtins.input", lambda prompt="": "")
    assert surroundings.restored() == []

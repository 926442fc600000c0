"""The capstone: a filter of the package's pieces scores like it, and each mistake is found where it was put."""

import csv
import json
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag
from whole import few

from vislam_edu import ekf_slam, se3, simulate
from vislam_edu.belief import Belief
from vislam_edu.course.ch13 import capstone
from vislam_edu.course.ch13 import exercises as chapter13
from vislam_edu.course.checks.edit import calling, edited
from vislam_edu.course.checks.verdict import NOT_WRITTEN, RIGHT, WRONG, judge
from vislam_edu.course.exercises import EXERCISES
from vislam_edu.course.grading import borrowing, grading, report, submission
from vislam_edu.noise import Noise
from vislam_edu.widgets import Explorer

ROOT = Path(__file__).parents[2]

# --- a capstone filled from ekf_slam ------------------------------------------------------------------------

def predict(T, P, twist, tau, noise):
    n = (len(P) - 6) // 3
    after = ekf_slam.predict(Belief(T, np.zeros((n, 3)), np.arange(n), P), twist, tau, noise)
    return after.world_T_imu, after.covariance


def update(T, landmarks, P, rows, pixels, camera, noise):
    seen = landmarks[rows]
    H = ekf_slam.joint_jacobian(camera.landmark_jacobian(T, seen), camera.pose_jacobian(T, seen), rows, len(landmarks))
    residual = (pixels - camera.observe(T, seen)[0]).ravel()
    return ekf_slam.joint_update(T, landmarks, P, H, residual, noise.sigma_px**2 * np.eye(len(residual)))


def birth(T, landmarks, P, pixels, camera, noise):
    point = camera.triangulate(pixels)[0]
    R = camera.imu_T_cam[:3, :3]
    C = R @ camera.triangulation_covariance(point, noise.sigma_px) @ R.T
    landmark, P = ekf_slam.new_landmark(P, T, se3.transform(camera.imu_T_cam, point), C)
    return np.vstack([landmarks, landmark]), P


PIECES = {"filter_predict": predict, "filter_update": update, "filter_birth": birth}


def filled(**changed):
    """The pieces by stage, some of them replaced; frame and run are made of them."""
    pieces = PIECES | changed
    frame = calling(pieces.pop("filter_frame", EXERCISES["filter_frame"].reference), **pieces)
    run = chapter13.assembled(**pieces, filter_frame=frame)
    return pieces | {"filter_frame": frame, "filter_run": run} | changed


def test_a_capstone_filled_from_ekf_slam_is_right_in_every_stage_and_scores_like_the_package(capsys):
    pieces = filled()
    assert capstone.first_wrong_stage(pieces) is None
    score = capstone.score(pieces["filter_run"], student=7)
    assert score.status == RIGHT
    assert capsys.readouterr().out.count("like the agreed filter") == len(score.drives) == 4
    for one in score.drives:
        assert one.mine.ate == pytest.approx(one.agreed.ate, rel=1e-6)
        assert one.mine.nees == pytest.approx(one.agreed.nees, rel=1e-5)
        assert one.mine.sigma == pytest.approx(one.agreed.sigma, rel=1e-6)


def test_the_packages_own_filter_scores_like_the_package():
    one = capstone.judged(capstone.package_run, capstone.unseen(7))
    assert (one.mine.ate, one.mine.nees) == (one.package.ate, one.package.nees)
    assert not one.faults
    assert one.package.ate < 0.7 * one.dead_reckoning.ate


MISTAKES = [(name, mistake.name) for name in capstone.STAGES for mistake in few(1, EXERCISES[name].mistakes)]


@pytest.mark.parametrize(("stage", "mistake"), MISTAKES)
def test_a_mistake_is_localised_to_the_stage_it_was_put_into(stage, mistake):
    [wrong] = [m.function for m in EXERCISES[stage].mistakes if m.name == mistake]
    verdict = capstone.first_wrong_stage(filled(**{stage: wrong}))
    assert (verdict.exercise, verdict.status, verdict.mistake) == (stage, WRONG, mistake)


@pytest.mark.parametrize(("stage", "mistake"), [("filter_update", "pose sign flipped"), ("filter_predict", "degrees"),
                                                ("filter_predict", "not scaled by tau")])
def test_a_wrong_filter_scores_worse(stage, mistake):
    [wrong] = [m.function for m in EXERCISES[stage].mistakes if m.name == mistake]
    assert capstone.judged(filled(**{stage: wrong})["filter_run"], capstone.unseen(1)).faults


@pytest.mark.parametrize("mistake", ["IMU sample of the wrong step", *(f"{name}, in filter_predict" for name in (
    "cross-covariances not propagated", "transition of the other direction", "sigma not squared"))])
def test_the_slalom_shows_what_many_landmarks_hide(mistake):
    museum = EXERCISES["filter_run"]
    [wrong] = [m.function for m in [*museum.mistakes, *museum.inherited] if m.name == mistake]
    one = capstone.judged(wrong, capstone.slalom())
    low, high = capstone.nees_band()
    assert low < one.agreed.nees < high
    assert one.faults


def test_a_wrong_filter_that_does_no_harm_is_not_praised(monkeypatch, capsys):
    [wrong] = [m.function for m in EXERCISES["filter_run"].inherited if m.name.startswith("first measurement used")]
    monkeypatch.setattr(capstone, "drives", lambda student: [capstone.unseen(student).slice(0, 10)])
    assert capstone.score(wrong).status == RIGHT
    said = capsys.readouterr().out
    assert said.startswith("filter_run: wrong")
    assert "first measurement used twice, in filter_frame" in said
    assert "no measurable harm on these drives" in said
    assert "like the agreed filter" not in said


def test_a_covariance_that_is_reported_too_large_is_seen_though_its_nees_is_good():
    def inflated(drive, noise):
        for T, landmarks, ids, P in filled()["filter_run"](drive, noise):
            yield T, landmarks, ids, 4 * P

    one = capstone.judged(inflated, capstone.unseen(1234))
    low, high = capstone.nees_band()
    assert low < one.mine.nees < high < one.agreed.nees
    assert one.mine.sigma == pytest.approx(2 * one.agreed.sigma)
    assert one.faults == ["sigma too large"]


# --- a whole filter, written in one piece -------------------------------------------------------------------

def whole(drive, noise):
    camera, Q, V = drive.camera, noise.twist_covariance, noise.pixel_covariance
    R_cam = camera.imu_T_cam[:3, :3]
    T, points, P = np.eye(4), {}, noise.initial_pose_covariance
    for k in range(drive.n_frames):
        if k:
            xi = drive.taus[k - 1] * drive.step_twists[k - 1]
            B = drive.taus[k - 1] * se3.right_jacobian(xi)
            F = block_diag(np.eye(3 * len(points)), se3.adjoint(se3.exp(-xi)))
            T = T @ se3.exp(xi)
            P = F @ P @ F.T
            P[-6:, -6:] += B @ Q @ B.T
        seen = dict(zip(*drive.observed(k)))
        stay = np.repeat([*[i in seen for i in points], True, True], 3)
        points, P = {i: m for i, m in points.items() if i in seen}, P[stay][:, stay]
        H, r = np.zeros((0, len(P))), []
        for j, (i, m) in enumerate(points.items()):
            row = np.zeros((4, len(P)))
            row[:, 3 * j:3 * j + 3] = camera.landmark_jacobian(T, m)
            row[:, -6:] = camera.pose_jacobian(T, m)
            H, r = np.vstack([H, row]), [*r, *(seen[i] - camera.observe(T, m)[0])]
        if points:
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.kron(np.eye(len(points)), V))
            d, P = K @ r, (np.eye(len(P)) - K @ H) @ P
            points = {i: m + d[3 * j:3 * j + 3] for j, (i, m) in enumerate(points.items())}
            T = T @ se3.exp(d[-6:])
        for i in [i for i in seen if i not in points and seen[i][0] - seen[i][2] > 1]:
            q = camera.triangulate(seen[i])[0]
            s, C = se3.transform(camera.imu_T_cam, q), camera.triangulation_covariance(q, noise.sigma_px)
            n, R = 3 * len(points), T[:3, :3]
            A = np.insert(np.eye(len(P)), 3 * [n], 0, axis=0)
            A[n:n + 3, n:] = R @ np.hstack([np.eye(3), -se3.so3_hat(s)])
            P = A @ P @ A.T
            P[n:n + 3, n:n + 3] += R @ R_cam @ C @ R_cam.T @ R.T
            points[i] = se3.transform(T, s)
        yield T, np.reshape(list(points.values()), (-1, 3)), np.array(list(points), int), P


# The stage, a word of the cause ("" where the check does not know it), and the edits.
ONE_MISTAKE = [
    ("filter_predict", "cross-cov", [
        ("P = F @ P @ F.T",
         "new = P.copy()\n            new[-6:, -6:] = (F @ P @ F.T)[-6:, -6:]\n            P = new")]),
    ("filter_predict", "other direction", [("se3.exp(-xi)", "se3.exp(xi)")]),
    ("filter_predict", "not squared", [("noise.twist_covariance", "np.sqrt(noise.twist_covariance)")]),
    ("filter_predict", "", [("B @ Q @ B.T", "2 * B @ Q @ B.T")]),
    ("filter_run", "wrong step", [("drive.step_twists[k - 1]", "drive.twists[k]")]),
    ("filter_run", "covariance at the start", [("noise.initial_pose_covariance", "np.eye(6)")]),
    ("filter_update", "pose sign", [("camera.pose_jacobian(T, m)", "-camera.pose_jacobian(T, m)")]),
    ("filter_update", "", [("np.eye(len(points)), V", "np.eye(len(points)), np.sqrt(V)")]),
    ("filter_birth", "not turned", [("R @ R_cam @ C @ R_cam.T @ R.T", "R @ C @ R.T")]),
    ("filter_birth", "", [("-se3.so3_hat(s)", "-se3.so3_hat(q)")]),
    ("filter_frame", "retired", [
        ("[i in seen for i in points]", "[True for i in points]"), ("points.items() if i in seen}", "points.items()}"),
        ("            row =", "            if i not in seen:\n                continue\n            row ="),
        ("np.eye(len(points)), V", "np.eye(len(r) // 4), V")]),
    ("filter_frame", "disparity", [(" and seen[i][0] - seen[i][2] > 1", "")]),
]


def test_of_twelve_whole_filters_with_one_mistake_the_stage_is_named_and_mostly_the_cause():
    stages = causes = 0
    for stage, cause, edits in ONE_MISTAKE:
        verdict = judge(EXERCISES["filter_run"], edited(whole, *edits))
        assert verdict.status == WRONG
        said = " ".join([verdict.text, verdict.more])
        stages += f"in {stage}" in said or (stage == "filter_run" and bool(verdict.mistake))
        causes += bool(cause) and cause in verdict.mistake
    assert judge(EXERCISES["filter_run"], whole).right
    assert (stages >= 10, causes >= 8) == (True, True), (stages, causes)


# --- where two results part ---------------------------------------------------------------------------------

def test_the_first_frame_and_entry_that_part_are_those_that_were_changed():
    def run(drive, noise):
        for k, (T, m, ids, P) in enumerate(filled()["filter_run"](drive, noise)):
            P = P.copy()
            if k >= 2:
                P[-1, -1] *= 1.5
            yield T, m, ids, P

    found = capstone.first_parting("filter_run", run)
    assert found.where.endswith("covariance of frame 2")
    assert found.entry == (5, 5)
    assert found.mine[5, 5] == pytest.approx(1.5 * found.package[5, 5])
    assert "look in filter_predict" in found.look


def test_the_picture_frames_the_entry_in_both_matrices_and_their_difference(capsys):
    [wrong] = [m.function for m in EXERCISES["filter_predict"].mistakes if m.name == "cross-covariances not propagated"]
    figure = capstone.compare("filter_predict", wrong)
    assert "entry [0, 3]" in capsys.readouterr().out
    frames = [patch.get_xy() for patch in figure.axes[0].patches]
    assert frames == [(2.5, -0.5), (2.5 + 10, -0.5), (2.5 + 20, -0.5)]  # matrices of 9 columns, one column apart
    apart = np.asarray(figure.axes[0].images[0].get_array())[:, 20:]  # of this mistake in the cross terms alone
    assert np.abs(apart).max() == 1
    assert not apart[:3, :3].any()
    assert np.abs(apart[3:, 3:]).max() < 1e-12  # but for rounding
    assert apart[:3, 3:].all()
    assert capstone.compare("filter_predict", predict) is None


def test_a_stage_that_raises_or_returns_too_little_gets_a_sentence(capsys):
    def unpacked(T, landmarks, P, rows, pixels, camera, noise):
        return np.zeros(4) + camera.observe(T, landmarks[rows])

    def only_the_pose(T, landmarks, P, rows, pixels, camera, noise):
        return T

    assert capstone.compare("filter_update", unpacked) is None
    assert "ValueError" in capsys.readouterr().out
    assert capstone.compare("filter_update", only_the_pose) is None
    assert "landmarks" in capsys.readouterr().out


def test_a_filter_that_returns_its_last_state_is_told_to_yield_each():
    def last(drive, noise):
        return list(filled()["filter_run"](drive, noise))[-1]

    assert "it must yield the four parts of a state after each frame" in judge(EXERCISES["filter_run"], last).text


# --- what is not right must not hang, nor fill memory ---------------------------------------------------------

def test_stubs_are_not_written_yet(capsys):
    def stub(drive, noise):
        raise NotImplementedError

    def generator(drive, noise):
        raise NotImplementedError
        yield

    for function in (stub, generator):
        assert capstone.score(function).status == NOT_WRITTEN
        assert capstone.compare("filter_run", function) is None
    assert capsys.readouterr().out.splitlines() == 4 * ["filter_run: not written yet"]


def test_a_filter_that_never_ends_or_grows_is_stopped():
    drive = capstone.unseen(0)

    def endless(drive, noise):
        while True:
            pass

    def growing(drive, noise):
        for n in range(1, 1000):
            yield np.eye(4), np.zeros((50 * n, 3)), np.arange(50 * n), np.eye(150 * n + 6)

    def short(drive, noise):
        yield np.eye(4), np.empty((0, 3)), np.empty(0, int), np.eye(6)

    start = time.monotonic()
    assert "no end" in capstone.follow(endless, drive, limit=0.3).problem
    assert "landmarks" in capstone.follow(growing, drive).problem
    assert capstone.follow(short, drive).problem == "1 states for 100 frames"
    assert time.monotonic() - start < 10


def test_a_student_has_drives_that_no_other_has():
    assert len({capstone.seed_of(student, i) for student in range(200) for i in range(2)}) == 400
    assert capstone.unseen(3).pixels.tobytes() == capstone.unseen("3").pixels.tobytes()


def test_the_explorer_steps_a_students_filter():
    drive = simulate.first_steps().slice(0, 8)
    steps = list(capstone.steps(filled()["filter_run"], drive))
    births = sum(len(step.born) > 0 for step in steps)  # each a half-step of its own
    assert Explorer(steps, drive).n == 16 + births > 16


# --- for teachers ---------------------------------------------------------------------------------------------

def followed(source, scope):
    """What the grader is sent of a cell."""
    return [json.loads(json.dumps(submission._followed(name, call, scope))) for name, call in submission.calls(source)]


def test_scores_go_to_the_teachers_report(tmp_path, monkeypatch):
    monkeypatch.setattr(capstone, "drives", lambda student: [capstone.unseen(student).slice(0, 30)])
    monkeypatch.setattr(submission.surroundings, "restored", list)  # it would put the drives back
    monkeypatch.setattr(borrowing, "in_notebook", lambda function: True)
    results, _ = grading._judged(followed("capstone.score(run, student=5)", {"run": filled()["filter_run"]}), [])
    handed = grading.Submission("a.ipynb", list(results.values()))
    report.write([handed], tmp_path)
    [row] = list(csv.DictReader((tmp_path / "capstone.csv").open()))
    assert (row["notebook"], row["student"], row["drive"]) == ("a.ipynb", "5", "unseen 1")
    content = json.loads((tmp_path / "exercises.json").read_text())
    assert content[0]["exercises"][0]["score"]["drives"][0]["mine_ate"] == pytest.approx(float(row["mine_ate"]))
    feedback = (tmp_path / "feedback" / "a.md").read_text()
    assert f"\n| unseen 1 | {float(row['mine_ate']):.2f} | {float(row['agreed_ate']):.2f} | " in feedback


def test_nothing_is_right_in_the_notebook_as_it_is_shipped(monkeypatch, capsys):
    notebook = json.loads((ROOT / "notebooks" / "13_your_own_filter.ipynb").read_text(encoding="utf-8"))
    sources = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    cells = [source for source in sources if source.startswith(("import", "from", "def ")) or "check." in source
             or "capstone.score" in source]
    scope, entries = {}, []
    for source in cells:
        with monkeypatch.context() as patch:
            patch.setattr(capstone, "drives", lambda student: [capstone.unseen(student).slice(0, 10)])
            exec(source, scope)
            entries += followed(source, scope)
    results, _ = grading._judged(entries, sources)
    assert set(capstone.STAGES) <= set(results)
    assert {result.status for result in results.values()} == {NOT_WRITTEN}


def test_a_score_never_replaces_the_verdict_of_the_check(monkeypatch):
    def stands_still(drive, noise):
        for _ in range(drive.n_frames):
            yield np.eye(4), np.empty((0, 3)), np.empty(0, int), noise.initial_pose_covariance

    monkeypatch.setattr(capstone, "drives", lambda student: [capstone.unseen(student).slice(0, 10)])
    monkeypatch.setattr(submission.surroundings, "restored", list)  # it would put the drives back
    monkeypatch.setattr(borrowing, "in_notebook", lambda function: function is not capstone.agreed_run)
    entries = followed("capstone.score(right)\ncapstone.score(capstone.agreed_run)\ncheck.filter_run(wrong)", {
        "wrong": stands_still, "right": filled()["filter_run"], "capstone": capstone})
    result = grading._judged(entries, [])[0]["filter_run"]
    assert result.status == WRONG
    assert len(result.score["drives"]) == 1


def test_the_noise_of_the_capstone_is_that_of_its_drives():
    assert vars(capstone.NOISE).keys() == vars(Noise()).keys()
    assert (capstone.NOISE.sigma_v, capstone.NOISE.sigma_omega, capstone.NOISE.sigma_px) == (0.5, 0.05, 0.7)

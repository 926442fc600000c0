"""`Drive`: the sparse form says what the dense array says, whatever is cut from it; faults are named."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vislam_edu import se3
from vislam_edu.drive import DriveError
from vislam_edu.recordings.features import drive_from_features
from vislam_edu.stereo import StereoCamera

K = np.array([[550.0, 0, 680], [0, 550, 240], [0, 0, 1]])
IMU_R_CAM = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
CAMERA = StereoCamera(K, 0.6, se3.inverse(se3.pose(IMU_R_CAM, np.array([1.5, 0.1, -0.6]))))


def fields(tracks, n_frames, seed=0, **changes):
    """What `drive_from_features` needs; `tracks` holds the first and last frame of each landmark, or None."""
    rng = np.random.default_rng(seed)
    features = np.full((4, len(tracks), n_frames), np.nan)
    for i, track in enumerate(tracks):
        if track is not None:
            first, last = track
            features[:, i, first:last + 1] = rng.uniform(0, 1000, (4, last + 1 - first))
    poses = se3.exp(rng.normal(size=(n_frames, 6)))
    return {"times": 1.3e9 + 0.1 * np.arange(n_frames), "twists": rng.normal(size=(n_frames, 6)),
            "features": features, "camera": CAMERA, "name": "small", "source": "made up",
            "history": ("made",), "truth_world_T_cam": poses,
            "truth_landmarks": rng.normal(size=(len(tracks), 3))} | changes


def small_drive(**changes):
    return drive_from_features(**fields([(0, 2), None, (1, 4), (3, 5), (5, 5)], 6, **changes))


def dense(drive):
    """What the drive shows, as an array that compares equal where it is NaN."""
    return np.nan_to_num(drive.features, nan=-1e9)


@st.composite
def drives(draw):
    n_frames = draw(st.integers(1, 8))
    frame = st.integers(0, n_frames - 1)
    track = st.none() | st.tuples(frame, frame).map(lambda ends: (min(ends), max(ends)))
    tracks = draw(st.lists(track, max_size=6))
    return drive_from_features(**fields(tracks, n_frames, seed=draw(st.integers(0, 999))))


# the sparse form


@given(drives())
def test_sparse_form_says_what_the_dense_array_says(drive):
    features = drive.features
    seen = ~np.isnan(features[0])
    again = drive_from_features(drive.times, drive.twists, features, drive.camera)
    assert np.array_equal(dense(again), dense(drive))
    assert np.array_equal(drive.visible, seen.sum(axis=0))
    for k in range(drive.n_frames):
        ids, pixels = drive.observed(k)
        assert np.array_equal(ids, np.flatnonzero(seen[:, k]))
        assert np.array_equal(pixels, features[:, ids, k].T)
    for i in range(drive.n_landmarks):
        frames = np.flatnonzero(seen[i])
        assert drive.first_seen[i] == (frames[0] if frames.size else -1)
        assert drive.last_seen[i] == (frames[-1] if frames.size else -1)


def test_minus_one_and_nan_both_mean_not_seen():
    with_nan = fields([(0, 1), (1, 2)], 3)
    with_minus_one = with_nan | {"features": np.nan_to_num(with_nan["features"], nan=-1.0)}
    expected = dense(drive_from_features(**with_nan))
    assert np.array_equal(dense(drive_from_features(**with_minus_one)), expected)


@pytest.mark.parametrize("chunk", [1, 7, 13, 1 << 20])
def test_conversion_does_not_depend_on_the_chunk(monkeypatch, chunk):
    expected = small_drive()
    monkeypatch.setattr("vislam_edu.recordings.features._CHUNK", chunk)
    drive = small_drive()
    assert np.array_equal(drive.landmark, expected.landmark)
    assert np.array_equal(drive.pixels, expected.pixels)


def test_single_precision_and_whole_pixels_are_read():
    features = np.full((4, 1, 2), -1, dtype=np.int32)
    features[:, 0, 0] = [10, 20, 5, 20]
    for dtype in (np.int32, np.float32):
        drive = drive_from_features([0, 1], np.zeros((2, 6)), features.astype(dtype), CAMERA)
        assert drive.pixels.tolist() == [[10.0, 20.0, 5.0, 20.0]]


def test_steps():
    drive = small_drive()
    assert drive.taus == pytest.approx(np.full(5, 0.1), rel=1e-5)
    assert drive.duration == pytest.approx(0.5, rel=1e-5)
    assert np.array_equal(drive.step_twists, drive.twists[:5])
    assert np.array_equal(drive.replace(imu_sample="k+1").step_twists, drive.twists[1:])
    mean = drive.replace(imu_sample="mean").step_twists
    assert mean == pytest.approx((drive.twists[:5] + drive.twists[1:]) / 2)


def test_arrays_are_read_only_copies():
    twists = np.zeros((6, 6))
    drive = small_drive(twists=twists)
    twists[0] = 1.0
    assert not drive.twists.any()
    arrays = "times", "twists", "frame_start", "landmark", "pixels", "truth_world_T_cam", "truth_landmarks"
    for name in arrays:
        with pytest.raises(ValueError, match="read-only"):
            getattr(drive, name)[0] = 0


@pytest.mark.parametrize("k", [-1, 6])
def test_observed_refuses_frames_that_do_not_exist(k):
    with pytest.raises(IndexError, match=f"frame {k} "):
        small_drive().observed(k)


# cutting


@given(drives(), st.data())
def test_slice(drive, data):
    start = data.draw(st.integers(0, drive.n_frames - 1))
    stop = data.draw(st.integers(start + 1, drive.n_frames))
    part = drive.slice(start, stop)
    shown = dense(drive)[:, :, start:stop]
    kept = (shown[0] != -1e9).any(axis=1)
    assert np.array_equal(dense(part), shown[:, kept])
    assert np.array_equal(part.times, drive.times[start:stop])
    assert np.array_equal(part.twists, drive.twists[start:stop])
    assert np.array_equal(part.truth_world_T_cam, drive.truth_world_T_cam[start:stop])
    assert np.array_equal(part.truth_landmarks, drive.truth_landmarks[kept])
    assert (part.name, part.source, part.history) == (drive.name, drive.source, drive.history)

    first = data.draw(st.integers(0, part.n_frames - 1))
    assert np.array_equal(dense(part.slice(first)), dense(drive.slice(start + first, stop)))
    assert np.array_equal(dense(drive.slice(start - drive.n_frames, stop)), dense(part))


@given(drives(), st.integers(1, 8))
def test_thin(drive, every):
    thinned = drive.subsample(every)
    assert np.array_equal(dense(thinned), dense(drive)[:, ::every])
    assert np.array_equal(thinned.truth_landmarks, drive.truth_landmarks[::every])
    assert np.array_equal(thinned.truth_world_T_cam, drive.truth_world_T_cam)


@given(drives(), st.data())
def test_keep_landmarks(drive, data):
    size = drive.n_landmarks
    mask = np.array(data.draw(st.lists(st.booleans(), min_size=size, max_size=size)), dtype=bool)
    kept = drive.keep_landmarks(mask)
    assert np.array_equal(dense(kept), dense(drive)[:, mask])
    assert np.array_equal(kept.truth_landmarks, drive.truth_landmarks[mask])


@given(drives(), st.data())
def test_keep_observations_that_end_tracks_early(drive, data):
    size, last = drive.n_landmarks, st.integers(-1, drive.n_frames - 1)
    end = np.array(data.draw(st.lists(last, min_size=size, max_size=size)), dtype=int)
    kept = drive.keep_observations(drive.frame <= end[drive.landmark])
    expected = dense(drive)
    expected[:, np.arange(drive.n_frames) > end[:, None]] = -1e9
    left = (expected[0] != -1e9).any(axis=1)
    assert np.array_equal(dense(kept), expected[:, left])
    assert np.array_equal(kept.truth_landmarks, drive.truth_landmarks[left])


def test_keep_observations_refuses_to_tear_a_track():
    drive = small_drive()
    with pytest.raises(DriveError, match=r"landmark 2 is seen in frame 1, then not, and again in frame 3"):
        drive.keep_observations(~((drive.landmark == 2) & (drive.frame == 2)))


@pytest.mark.parametrize("cut", [(3, 3), (6,), (4, 2)], ids=str)
def test_slice_refuses_to_be_empty(cut):
    with pytest.raises(DriveError, match="slice: no frame"):
        small_drive().slice(*cut)


@pytest.mark.parametrize("every", [0, -1, 2.5])
def test_thin_refuses_what_is_no_count(every):
    with pytest.raises(ValueError, match="every"):
        small_drive().subsample(every)


def test_masks_must_be_boolean_and_of_the_right_length():
    drive = small_drive()
    for mask in (np.ones(3, bool), np.arange(5), np.ones((5, 1), bool)):
        with pytest.raises(ValueError, match=r"mask: .* expected bool"):
            drive.keep_landmarks(mask)
        with pytest.raises(ValueError, match=r"mask: .* expected bool"):
            drive.keep_observations(mask)


# truth


@given(drives())
def test_truth_is_anchored_at_the_first_imu_frame(drive):
    poses, landmarks = drive.true_world_T_imu, drive.true_landmarks
    assert poses[0] == pytest.approx(np.eye(4), abs=1e-12)
    # what a camera sees does not depend on the choice of the world
    seen_in_file_world = se3.transform(se3.inverse(drive.truth_world_T_cam)[:, None], drive.truth_landmarks)
    assert drive.camera.to_cam(poses[:, None], landmarks) == pytest.approx(seen_in_file_world, abs=1e-9)


def test_frames_without_truth_stay_nan_and_the_first_known_one_is_the_anchor():
    poses = np.array(small_drive().truth_world_T_cam)
    poses[[0, 1, 4]] = np.nan
    drive = small_drive(truth_world_T_cam=poses)
    assert np.isnan(drive.true_world_T_imu[[0, 1, 4]]).all()
    assert drive.true_world_T_imu[2] == pytest.approx(np.eye(4), abs=1e-12)
    assert not drive.slice(0, 2).has_truth
    assert not drive.slice(0, 2).has_true_landmarks


def test_no_truth():
    drive = small_drive(truth_world_T_cam=None, truth_landmarks=None)
    assert not drive.has_truth
    assert not drive.has_true_landmarks
    assert not small_drive(truth_landmarks=None).has_true_landmarks
    assert drive.slice(1, 4).subsample(2).truth_world_T_cam is None


# validation


def put(array, index, value):
    array = np.array(array)
    array[index] = value
    return array


GOOD = small_drive()
POSES = GOOD.truth_world_T_cam
BROKEN = {
    "times, shape": ({"times": GOOD.times[None]}, r"times: shape \(1, 6\)"),
    "times, nan": ({"times": put(GOOD.times, 3, np.nan)}, r"times: nan at index \(3,\)"),
    "times, repeated": ({"times": put(GOOD.times, 3, GOOD.times[2])}, "times: do not increase, frame 2 is"),
    "times, backwards": ({"times": GOOD.times[::-1]}, "times: do not increase, frame 0 is at"),
    "times, text": ({"times": list("abcdef")}, "times: could not convert"),
    "empty": ({"times": [], "twists": np.empty((0, 6)), "frame_start": [0]}, "times: the recording is empty"),
    "twists, shape": ({"twists": GOOD.twists.T[:3]}, r"twists: shape \(3, 6\), expected \(6, 6\)"),
    "twists, inf": ({"twists": put(GOOD.twists, (2, 4), np.inf)}, r"twists: inf at index \(2, 4\)"),
    "camera": ({"camera": K}, "camera: ndarray, expected a StereoCamera"),
    "imu_sample": ({"imu_sample": "k-1"}, "imu_sample: 'k-1'"),
    "frame_start, length": ({"frame_start": GOOD.frame_start[:-1]}, r"frame_start: shape \(6,\)"),
    "frame_start, falls": ({"frame_start": put(GOOD.frame_start, 2, 9)}, "frame_start: must rise"),
    "frame_start, end": ({"frame_start": put(GOOD.frame_start, -1, 9)}, "frame_start: must rise"),
    "landmark, range": ({"n_landmarks": 4}, "landmark: 4 at index 10, expected 0 to 3"),
    "landmark, order": ({"landmark": put(GOOD.landmark, [1, 2], [2, 0])}, "not ascending in frame 1"),
    "landmark, twice": ({"landmark": put(GOOD.landmark, 2, 0)}, "landmark: not ascending in frame 1"),
    "pixels, shape": ({"pixels": GOOD.pixels[:, :3]}, r"pixels: shape \(11, 3\), expected \(11, 4\)"),
    "pixels, nan": ({"pixels": put(GOOD.pixels, (5, 2), np.nan)}, r"pixels: nan at index \(5, 2\)"),
    "truth, shape": ({"truth_world_T_cam": np.eye(4)}, r"truth_world_T_cam: shape \(4, 4\)"),
    "truth, half": ({"truth_world_T_cam": put(POSES, (3, 0, 0), np.nan)}, "frame 3 is neither"),
    "truth, mirror": ({"truth_world_T_cam": put(POSES, 4, np.diag([1, 1, -1, 1]))},
                      "truth_world_T_cam: frame 4 is not a rigid motion"),
    "truth, scaled": ({"truth_world_T_cam": put(POSES, 4, np.diag([2, 2, 2, 1]))}, "frame 4 is not"),
    "truth, last row": ({"truth_world_T_cam": put(POSES, (4, 3, 0), 1)}, "frame 4 is not"),
    "truth landmarks, shape": ({"truth_landmarks": np.zeros((4, 3))}, r"truth_landmarks: shape \(4, 3\)"),
    "truth landmarks, inf": ({"truth_landmarks": put(GOOD.truth_landmarks, (3, 1), np.inf)}, "landmark 3 is"),
    "truth landmarks alone": ({"truth_world_T_cam": None}, "truth_landmarks: given without"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_fields_are_named(case):
    changes, message = BROKEN[case]
    with pytest.raises(DriveError, match=message):
        GOOD.replace(**changes)


def test_a_track_that_comes_back_is_named():
    drive = drive_from_features(**fields([(0, 5)] * 3, 6))
    with pytest.raises(DriveError, match="landmark 1 is seen in frame 1, then not, and again in frame 4"):
        drive.keep_observations((drive.landmark != 1) | (drive.frame < 2) | (drive.frame > 3))


@pytest.mark.parametrize("missing", [-1.0, np.nan])
@pytest.mark.parametrize("chunk", [1, 1 << 20])
def test_an_observation_with_some_numbers_missing_is_named(monkeypatch, missing, chunk):
    monkeypatch.setattr("vislam_edu.recordings.features._CHUNK", chunk)
    features = put(fields([(0, 5)] * 3, 6)["features"], ([2, 3], 2, 4), missing)
    with pytest.raises(DriveError, match=re.escape("features: landmark 2, frame 4: only some")):
        drive_from_features(GOOD.times, GOOD.twists, features, CAMERA)


def test_an_infinite_pixel_is_named():
    features = put(fields([(0, 5)] * 3, 6)["features"], (1, 2, 4), np.inf)
    with pytest.raises(DriveError, match=r"features: landmark 2, frame 4 is .*inf.* expected finite"):
        drive_from_features(GOOD.times, GOOD.twists, features, CAMERA)


@pytest.mark.parametrize("shape", [(4, 6), (3, 2, 6), (4, 2, 5)], ids=str)
def test_features_of_the_wrong_shape(shape):
    with pytest.raises(DriveError, match=re.escape(f"features: shape {shape}, expected (4")):
        drive_from_features(GOOD.times, GOOD.twists, np.zeros(shape), CAMERA)

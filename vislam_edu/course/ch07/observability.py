"""What stereo images and body twists can never tell, and whether a filter knows that.

Pick up the car with the whole street and put it down elsewhere, turned: every pixel and every twist stays the
same. Six directions of the joint state, three shifts and three turns, are therefore unobservable. A
linearised filter sees the world through the stacked rows H_k Phi_k of the observability matrix. With the
Jacobians of `RightPerturbation`, taken at estimates that change at every update, these rows no longer agree
on what they cannot see, their rank grows, and the filter reduces a variance that nothing has measured.

Source: Huang, Mourikis, Roumeliotis, Observability-based rules for designing consistent EKF SLAM estimators,
IJRR 2010; Barrau, Bonnabel, An EKF-SLAM algorithm with consistency properties, 2015.
"""

from dataclasses import dataclass
from functools import reduce

import numpy as np

from ... import se3
from ...belief import positions


@dataclass(frozen=True, eq=False)
class LinearisationPoints:
    """Where Jacobians are taken in F successive frames, for n landmarks that are in the state in all of them.

    world_T_imu : (F, 4, 4) and landmarks : (F, n, ...), as in `Belief.points`: where H_k is taken.
    increments : (F-1, 4, 4): the step from frame to frame along which an error is carried on.
    """

    world_T_imu: np.ndarray
    landmarks: np.ndarray
    increments: np.ndarray


def common_landmarks(steps):
    """(n,) ids of the landmarks that every frame of these steps could measure. steps : list of `Step`."""
    return reduce(np.intersect1d, [step.prior.ids for step in steps])


def at_estimates(steps, ids) -> LinearisationPoints:
    """The points that the filter itself used: H at the predicted state, the step from one update to the next.

    steps : list of `Step` of `window_slam.run`, successive frames. ids : (n,), see `common_landmarks`.
    """
    priors = [step.prior for step in steps]
    poses = np.array([prior.world_T_imu for prior in priors])
    landmarks = np.array([prior.points[np.searchsorted(prior.ids, ids)] for prior in priors])
    updated = np.array([step.posterior.world_T_imu for step in steps])
    return LinearisationPoints(poses, landmarks, se3.inverse(updated[:-1]) @ poses[1:])


def at_truth(drive, frames, ids) -> LinearisationPoints:
    """The points an oracle would use: the true states, of error states whose landmarks are points of the world.

    drive : Drive with truth. frames : (F,) successive frames. ids : (n,).
    """
    poses = drive.true_world_T_imu[frames]
    landmarks = np.broadcast_to(drive.true_landmarks[ids], (len(poses), len(ids), 3))
    return LinearisationPoints(poses, landmarks, se3.inverse(poses[:-1]) @ poses[1:])


def observability_matrix(error_state, camera, points):
    """H_k Phi_k for each frame k: how its images depend on the error that the state has in the first frame.

    error_state : `ErrorState`. camera : StereoCamera. points : LinearisationPoints.
    Returns (F, 3n, 3n+6), columns ordered [landmarks, position, rotation]; `reshape(-1, 3n+6)` stacks the frames.
    """
    frames, n = points.landmarks.shape[:2]
    Phi = np.eye(6)  # of the pose; landmarks stand still
    blocks = np.zeros((frames, n, 3, n, 3))
    pose_columns = np.empty((frames, n, 3, 6))
    each = np.arange(n)
    for k, (T, landmarks) in enumerate(zip(points.world_T_imu, points.landmarks)):
        if k > 0:
            F, _ = error_state.pose_transition(T, points.increments[k - 1], np.eye(6))
            Phi = F @ Phi
        _, blocks[k, each, :, each, :], H_pose = error_state.measure(camera, T, landmarks)
        pose_columns[k] = H_pose @ Phi
    return np.concatenate([blocks.reshape(frames, 3 * n, 3 * n), pose_columns.reshape(frames, 3 * n, 6)], axis=-1)


def rank_by_frame(matrix, tolerance=1e-9):
    """(F,) rank of all rows up to each frame: 3n if the six directions stay unseen, up to 3n + 6 if not.

    matrix : (F, r, c) as `observability_matrix` returns it. tolerance : singular values below this share of the largest
    count as zero. Columns are brought to length 1 first, so that metres and radians do not matter.
    """
    length = np.linalg.norm(matrix, axis=(0, 1))
    matrix = matrix / np.where(length > 0, length, 1)  # the right-invariant rotation columns are zero
    ranks = []
    for k in range(len(matrix)):
        singular = np.linalg.svd(matrix[:k + 1].reshape(-1, matrix.shape[-1]), compute_uv=False)
        ranks.append(int(np.sum(singular > tolerance * singular[0])))
    return np.array(ranks)


def global_directions(error_state, world_T_imu, landmarks):
    """(3n+6, 6): the error that a shift or a turn of car and map as one amounts to; columns [shift, turn].

    error_state : `ErrorState`. world_T_imu : (4, 4). landmarks : (n, ...), as in `Belief.points`.
    For a twist xi of the world, T' = exp(xi^) T and m' = exp(xi^) m. These columns span what stereo and body
    twists cannot tell: every H_k Phi_k, taken at the true states, maps them to zero.
    """
    turn = np.broadcast_to(np.eye(3), (len(landmarks), 3, 3))
    moved = np.concatenate([turn, -se3.so3_hat(positions(landmarks))], axis=-1)
    pose_moved = np.eye(6)
    pose_moved[:3, 3:] = -se3.so3_hat(world_T_imu[:3, 3])
    pose_error = np.linalg.solve(error_state.world_pose(world_T_imu), pose_moved)
    C = error_state.world_landmark(landmarks)
    landmark_error = np.linalg.solve(error_state.metres(landmarks), moved) - C @ pose_error
    return np.concatenate([landmark_error.reshape(-1, 6), pose_error])


def information_gained(error_state, matrix, points):
    """(6,): how strongly the rows of all frames together see each global direction; 0 where they do not.

    matrix, points : as above. The length of H Phi d for the direction d of `global_directions` in the first
    frame: px per metre of shift, px per radian of turn, over all measurements.
    """
    directions = global_directions(error_state, points.world_T_imu[0], points.landmarks[0])
    return np.linalg.norm(matrix.reshape(-1, matrix.shape[-1]) @ directions, axis=0)

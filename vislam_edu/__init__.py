"""Visual-inertial SLAM with an extended Kalman filter, written to be read.

Conventions, the same in every file and every notebook:

poses           `world_T_imu` (4, 4) maps IMU coordinates to world coordinates; `a_T_b @ b_T_c = a_T_c`
frames          world; imu (body: x forward, y left, z up); cam (left optical: x right, y down, z forward)
extrinsics      `cam_T_imu`, whichever way a file stores it
twist           `[v, omega]`, translation first, m/s and rad/s, shape (..., 6)
pixels          `[u_left, v_left, u_right, v_right]`, px
not seen        NaN inside the package, -1 in files
perturbation    right, `T = T_mean exp(epsilon^)`, unless a name says `invariant`
noise           `sigma_v` m/s and `sigma_omega` rad/s per IMU sample (so W = tau^2 diag(...)), `sigma_px` px
joint state     landmarks first, then pose: covariance (3n+6, 3n+6)
arrays          everything broadcasts over leading axes

What the chapters use, file by file; `help(vislam_edu.se3.exp)` tells the rest. All other names serve these.

se3             hat so3_hat curly_hat so3_exp so3_log exp log pose inverse transform Adjoint odot right_jacobian
stereo          StereoCamera pi dpi_dq bearing triangulate_bearings
drive           Drive
recordings      find load load_ground_truth
faults          flip_imu_axes wrong_lever_arm add_gyro_bias delay_imu copy_frames outlier_tracks
simulate        street_loop perfect_street_loop add_noise
style           use COLOURS LABELS line ellipse_points two_digits on_a_page
noise           Noise
kalman          innovation_covariance nis gate_threshold gain update central_difference
odometry        Trajectory PoseBelief dead_reckon predict localize
mapping         run triangulated as_report
error_state     RightPerturbation RightInvariant
motion          ImuDriven TwistAndBias
slam            run correlated as_report without_cross_covariance contains never
consensus       measure
smoother        final_map
metrics         position_errors ate kitti_drift nees pose_nees average_nis chi2_band
consistency     Filter initial_pose judge table
museum_drives   PIECES visit used_twice
observability   common_landmarks at_estimates at_truth observability_matrix rank_by_frame information_gained
visual_odometry estimate
track_health    copied copy_steps
cures           end_tracks_at_copies
measured_noise  measure
audit           audit
plots           new_figure new_map finish view_around trajectories heading heading_sigma heading_band
                position_covariance draw_trajectory draw_truth draw_landmarks draw_ellipses draw_position_ellipses
pipeline        Result run first_sight collect_mapping collect_slam noise_of_real_drive world_landmark_covariance
report_figures  initial_trajectory initial_landmarks mapped_landmarks initial_and_mapped_landmarks slam_landmarks
                both_trajectories all_landmarks
widgets         Stepper Panel
exercises       check hint solution EXERCISES

and of the pictures, `pictures.twist` and so on:

twist           TwistPicture plane_ellipse banana
stereo_depth    StereoDepthPicture depth_sigma
mapping         MappingPicture
localisation    LocalisationPicture
joint           JointPicture
tuning          TuningPicture
two_filters     TwoFiltersPicture
cures_panel     CuresPicture
subsampling     SubsamplingPicture
museum_tour     MuseumPicture gallery
"""

__version__ = "0.1.0"

import scipy.linalg  # noqa: F401 - loads the linear algebra libraries that the next lines speak to
import threadpoolctl

# The filters' matrices have a few hundred rows. At that size the threads of one product wait for each other longer
# than they work, and on a busy machine many times longer: one thread does the linear algebra of this process.
threadpoolctl.threadpool_limits(limits=1, user_api="blas")

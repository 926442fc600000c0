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
"""

__version__ = "0.1.0"

import scipy.linalg  # noqa: F401 - loads the linear algebra libraries that the next lines speak to
import threadpoolctl

# The filters' matrices have a few hundred rows. At that size the threads of one product wait for each other longer
# than they work, and on a busy machine many times longer: one thread does the linear algebra of this process.
threadpoolctl.threadpool_limits(limits=1, user_api="blas")

"""Joint landmark-and-pose EKF, plain: the report's section 3.3.2 line by line. In work."""

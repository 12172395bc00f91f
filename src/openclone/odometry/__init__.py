"""Where the robot is: LiDAR odometry and its error model."""

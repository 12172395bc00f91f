"""What a G1 is: joints, limits, gains, key points, model, kinematics."""

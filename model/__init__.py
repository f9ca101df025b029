"""What the robot is: effects, kinematics, equations of motion, statics and modes, as symbolic models."""

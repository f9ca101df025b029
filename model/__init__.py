"""The model of the robot: effects, kinematics, equations of motion, statics and modes, in symbols."""

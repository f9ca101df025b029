"""Input shapers compared on a scene: residual vibration against added time, path deviation, jerk and torque."""

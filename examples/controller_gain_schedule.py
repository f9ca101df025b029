"""Gains that follow the pose: a PD whose proportional gain is scheduled over the angle of joint 1, against constant gains.

python controller_gain_schedule.py
"""

import flexfmu

# one shape of each proximal link
few = {"effects.proximal_bending": 1, "effects.distal_axial": 0}
robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1, **few})
# factors of the gains at three angles of joint 1 [rad], linear between them
schedule = {
    "over": "joint1.position",
    "at": [2.0, 2.6, 3.2],
    "proportional": [0.6, 1.0, 1.6],
    "derivative": [0.8, 1.0, 1.2],
}

for what, over_pose in {"constant gains": None, "scheduled gains": schedule}.items():
    pd = flexfmu.control.pd(proportional=8e3, derivative=80.0, sample_time=1e-3, schedule=over_pose)
    rows = flexfmu.margins(robot, poses=3, controllers=[pd]).rows()
    for s in (0.0, 0.5, 1.0):
        least = min(row["gain_margin"] for row in rows if row["s"] == s)
        print(f"{what:16}   s = {s:.1f}   gain margin {least:5.2f}")

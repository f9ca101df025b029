"""A faster motion for a robot of your own: planned within limits, judged in the FMU, and written as a scene that every command takes.

The same from a shell, with the motion judged in other models too: flexfmu plan steel.toml

    python plan_own_robot.py
"""

from pathlib import Path

import flexfmu

if __name__ == "__main__":  # a plan may start processes
    scene = flexfmu.load_scene(Path(__file__).with_name("steel.toml"))

    # the fastest motion that leaves at most 5 µm for payloads within 10 %, by motors with 1.5 times the torque and any power
    limits = {"torque": {"ratio": 1.5}, "power": "free", "rms_torque": "free"}
    wishes = {"payload_band": 0.1, "residual": 5e-6, "corridor": 0.03, "limits": limits}
    plan = flexfmu.plan_motion(scene, **wishes, methods=["optimal"], robust=False, out="planned-steel")
    print(plan)
    for use in plan.chosen.uses:
        print(f"{use.name:20} {100 * use.share:5.1f} % used, at {use.where}")

    # the planned scene is one like any other
    run = flexfmu.run("planned-steel/planned.toml")
    print(f"residual vibration {1e6 * run.metrics.residual_vibration_amplitude:.2f} µm")

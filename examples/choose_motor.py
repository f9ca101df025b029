"""Three motors of a catalogue behind the same robot: one run, a table of margins. Values above 100 % are too much."""

import flexfmu

CATALOGUE = [
    flexfmu.Motor(0.64, 1.9, 630.0, rotor_inertia=2.6e-5, gear_ratio=35, gear_efficiency=0.92, name="200 W, 1:35"),
    flexfmu.Motor(1.27, 3.8, 630.0, rotor_inertia=4.4e-5, gear_ratio=25, gear_efficiency=0.94, name="400 W, 1:25"),
    flexfmu.Motor(2.40, 7.2, 630.0, rotor_inertia=1.4e-4, gear_ratio=15, gear_efficiency=0.96, name="750 W, 1:15"),
]

run = flexfmu.run("barnard2012-6kg")
print(f"{'motor':14}{'joint':>6}{'peak torque':>13}{'RMS torque':>12}{'speed':>8}{'inertia ratio':>15}  fits")
for motor in CATALOGUE:
    for load in flexfmu.motor_loads(run, motor):
        peak, rms, speed = (f"{margin.use:.0%}" for margin in load.margins)
        verdict = "yes" if load.critical.use <= 1.0 else f"no: {load.critical.name}"
        print(f"{motor.name:14}{load.joint:6}{peak:>13}{rms:>12}{speed:>8}{load.inertia_ratio:15.1f}  {verdict}")

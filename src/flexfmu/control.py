"""Controllers, for `flexfmu.run(scene, controllers=[...])`: the tables ``[[controller]]`` of a scene file.

A controller may also be a function of yours (`flexfmu.controller`), an object of a class of yours, a python-control system, or the
path of an FMU.
"""

from flexfmu.model.scene import controllers, loop
from flexfmu.parts import part, seldom

__all__ = [
    "Equilibrium",
    "c_function",
    "cascade",
    "computed_torque",
    "control_block",
    "disturbance_observer",
    "feedforward",
    "fmu",
    "friction_compensation",
    "from_control",
    "gravity_feedforward",
    "h_infinity",
    "learning",
    "lqg",
    "operating_point",
    "pd",
    "pid",
    "python",
    "state_feedback",
    "state_space",
    "static_feedforward",
]

__getattr__ = seldom(
    __name__,
    {
        **dict.fromkeys(("control_block", "from_control"), "flexfmu.cosim.control.controllers.from_control"),
        **dict.fromkeys(
            ("Equilibrium", "state_feedback", "static_feedforward"), "flexfmu.cosim.control.controllers.state_feedback"
        ),
        **dict.fromkeys(("operating_point",), "flexfmu.model.linear"),
    },
)

pd = part(controllers.PdSection, "control.pd(proportional=1e4, derivative=100.0, sample_time=1e-3)")
pid = part(controllers.PidSection, "control.pid(proportional=1e4, integral=1e5, derivative=100.0, sample_time=1e-3)")
cascade = part(
    controllers.CascadeSection,
    'control.cascade(position={"proportional": 60.0}, velocity={"proportional": 120.0}, sample_time=1e-3)',
)
computed_torque = part(
    controllers.ComputedTorqueSection,
    "control.computed_torque(proportional=3600.0, derivative=120.0, sample_time=1e-3)",
)
feedforward = part(controllers.FeedforwardSection, 'control.feedforward(robot="flexible", sample_time=1e-3)')
gravity_feedforward = part(controllers.GravityFeedforwardSection, "control.gravity_feedforward(sample_time=1e-3)")
friction_compensation = part(
    controllers.FrictionCompensationSection,
    "control.friction_compensation(viscous=0.2, coulomb=0.5, velocity=0.01, sample_time=1e-3)",
)
disturbance_observer = part(
    controllers.DisturbanceObserverSection,
    "control.disturbance_observer(time_constant=5e-3, inertia=0.7, sample_time=1e-3)",
)
learning = part(controllers.LearningSection, "control.learning(cycles=5, gain=500.0, sample_time=1e-3)")
lqg = part(controllers.StateFeedbackSection, 'control.lqg(pose="end", sample_time=1e-3)')
h_infinity = part(controllers.HInfinitySection, "control.h_infinity(bandwidth=10.0, sample_time=1e-3)")
state_space = part(
    controllers.StateSpaceSection,
    'control.state_space(A=[[0.0]], B=[[1.0]], C=[[1.0]], inputs=["joint1.position"], outputs=["joint1.torque"], sample_time=1e-3)',
)
c_function = part(
    controllers.CFunctionSection,
    'control.c_function(source="pd.c", inputs=["joint1.position"], outputs=["joint1.torque"], sample_time=1e-3)',
)
python = part(loop.PythonSection, 'control.python(source="my_controllers:Damper", arguments={"damping": 100.0})')
fmu = part(loop.FmuSection, 'control.fmu(path="controller.fmu", parameters={"gain": 2.0}, sample_time=1e-3)')

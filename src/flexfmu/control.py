"""Controllers, for `flexfmu.run(scene, controllers=[...])`: the tables ``[[controller]]`` of a scene file.

A controller may also be a function of yours (`flexfmu.controller`), an object of a class of yours, a python-control system, or the
path of an FMU.
"""

from flexfmu.model.scene import controllers, loop
from flexfmu.parts import family

__all__, __getattr__, __dir__ = family(
    __name__,
    {
        "pd(proportional=1e4, derivative=100.0, sample_time=1e-3)": controllers.PdSection,
        "pid(proportional=1e4, integral=1e5, derivative=100.0, sample_time=1e-3)": controllers.PidSection,
        'cascade(position={"proportional": 60.0}, velocity={"proportional": 120.0}, sample_time=1e-3)': controllers.CascadeSection,
        "computed_torque(proportional=3600.0, derivative=120.0, sample_time=1e-3)": controllers.ComputedTorqueSection,
        'feedforward(robot="flexible", sample_time=1e-3)': controllers.FeedforwardSection,
        "gravity_feedforward(sample_time=1e-3)": controllers.GravityFeedforwardSection,
        "friction_compensation(viscous=0.2, coulomb=0.5, velocity=0.01, sample_time=1e-3)": controllers.FrictionCompensationSection,
        "disturbance_observer(time_constant=5e-3, inertia=0.7, sample_time=1e-3)": controllers.DisturbanceObserverSection,
        "learning(cycles=5, gain=500.0, sample_time=1e-3)": controllers.LearningSection,
        'lqg(pose="end", sample_time=1e-3)': controllers.StateFeedbackSection,
        "h_infinity(bandwidth=10.0, sample_time=1e-3)": controllers.HInfinitySection,
        'state_space(A=[[0.0]], B=[[1.0]], C=[[1.0]], inputs=["joint1.position"], outputs=["joint1.torque"], sample_time=1e-3)': controllers.StateSpaceSection,
        'c_function(source="pd.c", inputs=["joint1.position"], outputs=["joint1.torque"], sample_time=1e-3)': controllers.CFunctionSection,
        'python(source="my_controllers:Damper", arguments={"damping": 100.0})': loop.PythonSection,
        'fmu(path="controller.fmu", parameters={"gain": 2.0}, sample_time=1e-3)': loop.FmuSection,
    },
    {
        "cosim.control.controllers.from_control": "control_block from_control",
        "cosim.control.controllers.state_feedback": "Equilibrium state_feedback static_feedforward",
        "model.linear": "operating_point",
    },
)

"""Controllers as blocks: PD, PID, computed torque, state feedback, linear systems, iterative learning."""

"""Safety gate, amplifier drivers, their emulators, and the thread that drives the coils.

Examples
--------
A gate passes no current until it is armed, and nothing beyond its limits:

>>> from microbot_ros.drive.gate import Gate, Limits
>>> gate = Gate(Limits(current_A=2.0, step_A=3.0, slew_A_per_s=10.0, command_timeout_s=0.1,
...                    deviation_A=0.3, settling_s=0.1, feedback_timeout_s=0.2,
...                    rated_current_A=1.0, thermal_s=8.0, idle_s=10.0), 2)
>>> gate.command((1.0, 0.0), 0.0)
(0.0, 0.0)
>>> _ = gate.measured((0.0, 0.0), 0.0)
>>> gate.arm(0.0), gate.command((1.0, 0.0), 0.0)
(None, (1.0, 0.0))
>>> gate.command((2.5, 0.0), 0.01)
(0.0, 0.0)
>>> print(gate.fault.reason, gate.fault.detail, sep=': ')
current limit: (2.5, 0) A is not within ±2 A
"""

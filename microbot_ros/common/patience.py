"""How long the package waits for what others do, in one record that a test may change."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Patience:
    """Longest times to wait [s].

    Attributes
    ----------
    write_s : float
        Time without an accepted byte after which a line is lost. Choice: the watchdog time of
        most devices.
    read_back_s : float
        Time in which a reading must confirm a zero. Choice: ten readings of the slowest protocol
        (50 ms); half would report a slow line as unconfirmed, twice delays every stop.
    arming_s : float
        Time of arming. Choice: 16 coils of 0.1 s settling take 3.2 s, with room for slow lines.
    disarming_s : float
        Time in which the line must accept a zero. Choice: two attempts on the slowest line.
    sentinel_s : float
        Time that a sentinel has to end before it is killed. Choice: five times the 0.2 s of its
        last zeros.
    find_s : float
        Time in which a node must be discovered. Choice: a message to a process that has just
        started may be lost and is repeated after 0.5 s, so ten attempts fit.
    ask_s : tuple of float
        Times after which a request without answer is sent again. Choice: longer than any service
        takes for its work. After the last the service counts as silent.
    arm_s : tuple of float
        Time for the only request to arm: a second one could arm after a STOP in between. Choice:
        longer than `arming_s`.
    stop_s : tuple of float
        Times after which a request to stop is repeated. Choice: the driver sends zero when it
        receives a request, and answers once that is read back, within `read_back_s`.
    take_s : float
        Time in which a controller must accept goals, a path or a plan. Choice: it reports five
        times a second.
    state_s : float
        Time in which a rig must report its state. Choice: five reports at 1 Hz.
    unseen_s : float
        Time without a particle, or without a message of the controller, that ends an experiment.
        Choice: a particle that is lost for less is usually found again.
    listeners_s : float
        Time after which a session is played without listeners. By default Fast DDS announces
        itself every 3 s, and the first announcement is sometimes lost.
    reopen_s : float
        Pause before a lost camera is tried again. Choice: a device that is plugged in works after
        it; half would fill the log.
    connection_s : float
        Life of an HTTP connection without an answer in progress. Choice: a page loads in less
        than 1 s, a recording in minutes.
    scheduler_s : float
        Time in which a Dask scheduler must answer. Choice: longer than any connection takes.
    """

    write_s: float = 0.1
    read_back_s: float = 0.5
    arming_s: float = 10.0
    disarming_s: float = 0.2
    sentinel_s: float = 1.0
    find_s: float = 5.0
    ask_s: tuple[float, ...] = (3.0, 3.0, 3.0, 3.0)
    arm_s: tuple[float, ...] = (12.0,)
    stop_s: tuple[float, ...] = (0.3, 0.7, 1.0, 1.0)
    take_s: float = 5.0
    state_s: float = 5.0
    unseen_s: float = 3.0
    listeners_s: float = 3.5
    reopen_s: float = 1.0
    connection_s: float = 30.0
    scheduler_s: float = 10.0


PATIENCE = Patience()
"""The patience of this process."""

"""Run a trained policy, for example from `microbot_ros.gym`, from an ONNX file."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.common import units
from microbot_ros.common.errors import InputError
from microbot_ros.common.settings import setting
from microbot_ros.control.contract import (
    ANY_GOALS,
    Controller,
    ControllerInput,
    FieldCommand,
    GoalError,
    ModelError,
    NoSolutionError,
    Progress,
    no_field,
)
from microbot_ros.control.policy_task import (
    PARTICLE_NUMBERS,
    SHARED_NUMBERS,
    PolicyTask,
    wanted_field,
)
from microbot_ros.control.steering.courses import Excitation

_NO_FILE = "'file' names no ONNX file"

EXECUTED_FILE = 'policy.file'
"""Parameter of the controller node that names a network, which is executed when it is set."""


@dataclass(frozen=True)
class PolicyParameters:
    """The policy, and the field before and after it."""

    file: str = setting('', 'ONNX file with the policy; see docs/how-to/train_a_controller.md.')
    field_mT: float = setting(
        5.0, 'Strength of the field while the policy does not drive.', lower=0.01, upper=100.0)
    learn_phi_std_rad: float = setting(
        0.2, 'Uncertainty of φ of every particle below which the policy '
             'drives.', lower=0.01, upper=1.5)
    learn_leg_s: float = setting(
        1.0, 'Time on each side of the triangle that is driven before the policy starts and after '
             'it ends.', lower=0.1,
        upper=60.0)


class Policy(Controller):
    """Lets a policy bring each particle to its goal once.

    Until the response of all is known, and once all have reached their goals, the field runs
    through a triangle, which ends where it began.
    """

    interface_version = 1
    summary = 'Drive each particle to its goal once, by a learned policy.'
    takes = ANY_GOALS
    Parameters = PolicyParameters

    def __init__(self) -> None:
        super().__init__()
        self._policy: OnnxPolicy | None = None
        self.reset()

    def configure(self, parameters: Any) -> None:
        """Load the file of `parameters`; InputError if it is not such a policy."""
        self._policy = OnnxPolicy(Path(parameters.file)) if parameters.file else None
        super().configure(parameters)

    def activate(self, inputs: ControllerInput) -> None:
        """Raise ModelError without a file, or if the model of `inputs` is of rollers."""
        self._excitation.stop()
        if self._policy is None:
            raise ModelError(_NO_FILE)
        inputs.refuse_rollers()

    def reset(self) -> None:
        """Forget the goals and which have been reached."""
        self._task = PolicyTask()
        self._excitation = Excitation()

    def compute(self, inputs: ControllerInput) -> FieldCommand:
        """Return the policy's action for `inputs`; NoSolutionError if it is NaN."""
        p, policy, task = self.parameters, self._policy, self._task
        rows = task.rows(inputs)
        if not len(rows):
            return no_field('waiting for goals')
        if policy is None:
            raise ModelError(_NO_FILE)
        if len(rows) != policy.particles:
            raise GoalError(f'the policy is for {policy.particles} particles with a goal each; '
                            f'received {len(rows)} goals')
        particles = inputs.ids[rows]
        known = inputs.learned(p.learn_phi_std_rad)[rows] & (inputs.speed[rows] > 0)
        shown = task.observation(inputs) if known.all() else None
        done = not task.waiting.any()
        progress = Progress(f'{np.sum(~task.waiting)} of {len(rows)} particles have reached their '
                            'goals', done)
        if shown is None or done:
            command = self._excitation.command(
                inputs, p.learn_leg_s, units.to_si('field_mT', p.field_mT), particles=particles)
            return dataclasses.replace(command, progress=progress) if done else command
        self._excitation.stop()
        action = policy.answer(shown)
        field = wanted_field(action, inputs.limits.field)
        if not np.isfinite(field).all():
            raise NoSolutionError(f'the policy returned {action.tolist()}, not a finite field')
        return FieldCommand(field, progress=progress, particles=particles)


class OnnxPolicy:
    """Policy from an ONNX file at `path`: one input (1, 2 + 7 K), one output (1, 2), float32.

    It computes in the calling thread, so that equal inputs give equal actions. Raises InputError
    for a file that cannot be read or is something else, and without onnxruntime.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self._run, size = _load(path)
        self.particles, rest = divmod(size - SHARED_NUMBERS, PARTICLE_NUMBERS)
        """Number of particles K."""
        if rest or self.particles < 1:
            raise InputError(path, f'expected an input of {SHARED_NUMBERS} + {PARTICLE_NUMBERS} '
                             f'numbers per particle; found {size}')
        try:
            found = self._run(np.zeros((1, size), np.float32))
        except Exception as error:
            raise InputError(path, f'expected a policy that runs ({_first_line(error)})') from None
        if len(found) != 1 or np.shape(found[0]) != (1, 2):
            raise InputError(path, 'expected one output (1, 2); found '
                             + ', '.join(str(np.shape(one)) for one in found))

    def answer(self, observation: np.ndarray) -> np.ndarray:
        """Return the action (2,) for an `observation` (2 + 7 K,).

        Parameters
        ----------
        observation : ndarray, shape (2 + 7 K,)
            Observation.

        Returns
        -------
        ndarray, shape (2,)
            Action.
        """
        return np.asarray(self._run(observation[None])[0][0])


def _load(path: Path) -> tuple[Callable[[np.ndarray], list[Any]], int]:
    """Return a function that runs the network of a file, and the size of its input."""
    try:
        import onnxruntime
    except ModuleNotFoundError:
        raise InputError(path, 'expected onnxruntime to play it: pip install '
                         'microbot_ros[onnx]') from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.log_severity_level = 4  # what goes wrong is raised
    try:
        content = path.read_bytes()
        session = onnxruntime.InferenceSession(
            content, options, providers=['CPUExecutionProvider'])
    except OSError as error:
        raise InputError(path, f'expected a readable ONNX file ({error.strerror})') from None
    except Exception as error:
        raise InputError(path, f'expected an ONNX file ({_first_line(error)})') from None
    inputs = session.get_inputs()
    shape = inputs[0].shape if len(inputs) == 1 else []
    fits = len(shape) == 2 and isinstance(shape[1], int) and (
        shape[0] == 1 or not isinstance(shape[0], int))
    if not (fits and inputs[0].type == 'tensor(float)'):
        found = ', '.join(f'{one.type} {one.shape}' for one in inputs)
        raise InputError(path, f'expected one input, float (1, numbers); found {found}')
    name = inputs[0].name
    return (lambda shown: session.run(None, {name: shown})), shape[1]


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__

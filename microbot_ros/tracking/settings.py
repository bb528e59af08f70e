"""User settings of the tracker; those left out are found from the first frames."""

from __future__ import annotations

from typing import Literal

from microbot_ros.common.checked import Field, Settings, SettingsError
from microbot_ros.tracking.locate.colour import Weights
from microbot_ros.tracking.locate.kinds import Kind
from microbot_ros.tracking.locate.standing import Place


class TrackerSettings(Settings):
    """Settings of detection and linking; None: found from the first frames."""

    contrast: Literal['dark', 'bright'] | None = Field(
        default=None,
        description='whether the middle of a particle is darker or brighter than around it')
    shape: Literal['round', 'any'] | None = Field(
        default=None,
        description='round: fitted with the learned picture; any: clumps, by their outline')
    diameter_px: float | None = Field(
        default=None, ge=3, le=200, description='diameter of a particle at half its contrast [px]')
    min_contrast_grey: float | None = Field(
        default=None, gt=0, description='least contrast against the background [grey levels]')
    min_detection_sigma: float = Field(
        default=6.0, ge=4, le=100, description='least response of the search, in σ of its noise')
    min_quality: float = Field(
        default=0.6, ge=0, lt=1, description='least share of a picture that the fit explains')
    size_tolerance: float = Field(
        default=1.6, gt=1, le=2.4,
        description='largest ratio of a size to the typical, either way')
    cap: Literal['dark', 'bright'] = Field(
        default='dark',
        description='whether the cap is the darker or the brighter side of a particle')
    max_step_px: float | None = Field(
        default=None, gt=0,
        description='farthest a particle strays from its prediction in a frame [px]')
    confirm_frames: int = Field(
        default=3, ge=2, le=20,
        description='frames in which a particle must be seen before it has an id')
    coast_frames: int = Field(
        default=20, ge=0, le=1000, description='frames for which an unseen particle is predicted')
    learning_frames: int = Field(
        default=10, ge=1, le=200, description='frames from which appearance is learned')
    colour: Weights | None = Field(
        default=None,
        description='weights of red, green and blue in what is looked at; brightness if not '
        'said')
    kinds: tuple[Kind, ...] = Field(
        default=(), description='kinds to follow, from examples; nothing else is followed')
    standing: tuple[Place, ...] = Field(
        default=(), description='positions at which nothing of these kinds is a particle')

    def __post_init__(self) -> None:
        if self.colour is not None and not any(self.colour):
            raise SettingsError('expected a weight other than 0', 'colour')
        names = [kind.name for kind in self.kinds]
        if twice := [name for name in names if names.count(name) > 1]:
            raise SettingsError(f'expected different names; received {twice[0]} twice', 'kinds')

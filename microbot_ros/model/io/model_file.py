"""`model.yaml`: model and particles, as discovery writes them and controllers load them."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml

from microbot_ros.common.checked import Field, Settings
from microbot_ros.common.files import load_yaml, read_yaml, write_text
from microbot_ros.common.strict_yaml import StrictLoader
from microbot_ros.common.units import exact_display, exact_si
from microbot_ros.model.io.effect_table import EffectTable, build_effects
from microbot_ros.model.io.learned_table import LearnedEntry, read_term, write_term
from microbot_ros.model.model import Model, ParticleParameters, Propulsion

# Name of a particle's `speed` in files.
_SPEED = {'catalytic': 'v_um_s', 'rolling': 'gain_um_s_hz'}


class _ParticleEntry(Settings):
    id: Annotated[int, Field(ge=0, lt=2**53)]
    v_um_s: float = 0.0
    gain_um_s_hz: float = 0.0
    phi_rad: float


class _ModelFile(Settings):
    propulsion: Propulsion = 'catalytic'
    reference_field_mT: Annotated[float, Field(gt=0)]
    particles: tuple[_ParticleEntry, ...] = ()
    effects: EffectTable = Field(default_factory=dict)
    learned: tuple[LearnedEntry, ...] = ()

    def __post_init__(self) -> None:
        name = _SPEED[self.propulsion]
        for particle in self.particles:
            if particle.given & set(_SPEED.values()) != {name}:
                raise ValueError(f"expected '{name}' of each {self.propulsion} particle")
        ids = [particle.id for particle in self.particles]
        if len(set(ids)) != len(ids):
            raise ValueError(f'expected particles with different ids; received {ids}')


def read_model(path: str | Path) -> tuple[Model, ParticleParameters]:
    """Read a `model.yaml`, exact to the last bit.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    (Model, ParticleParameters)
        Model and particles, SI.

    Raises
    ------
    InputError
        If the file is not valid: file, line, key and expectation. For an unknown effect or
        parameter the message lists the known ones.
    """
    settings = read_yaml(path, _ModelFile)
    exact: dict[str, Any] = load_yaml(path, _ExactLoader)[1]
    reference = exact_si('reference_field_mT', exact['reference_field_mT'])
    model = Model(reference, settings.propulsion, build_effects(exact.get('effects') or {}),
                  tuple(map(read_term, exact.get('learned') or ())))
    name = _SPEED[settings.propulsion]
    rows = exact.get('particles') or []
    return model, ParticleParameters(
        np.array([particle.id for particle in settings.particles], dtype=int),
        np.array([exact_si(name, row[name]) for row in rows], dtype=float),
        np.array([exact_si('phi_rad', row['phi_rad']) for row in rows], dtype=float),
    )


def write_model(path: str | Path, model: Model, particles: ParticleParameters) -> None:
    """Write a `model.yaml` that `read_model` reads back equal.

    Parameters
    ----------
    path : str or Path
        The file.
    model : Model
        The model.
    particles : ParticleParameters
        The particles.

    Raises
    ------
    ValueError
        For values that are not finite or out of range; no file is written then.
    """
    name = _SPEED[model.propulsion]
    content = {
        'propulsion': model.propulsion,
        'reference_field_mT': exact_display('reference_field_mT', model.reference_field),
        'particles': [
            {'id': int(i), name: exact_display(name, float(v)), 'phi_rad': float(phi)}
            for i, v, phi in zip(particles.ids, particles.speed, particles.phi, strict=True)
        ],
        'effects': {
            effect.id: {
                p.name: exact_display(p.name, v) for p, v in effect.values().items()}
            for effect in model.effects
        },
        **({'learned': [write_term(term) for term in model.learned]} if model.learned else {}),
    }
    text = yaml.dump(content, Dumper=_ExactDumper, sort_keys=False)
    _ModelFile.from_content(yaml.safe_load(text))
    write_text(path, text)


class _ExactLoader(StrictLoader):
    """YAML loader that reads numbers as decimals: floats would lose digits."""


class _ExactDumper(yaml.SafeDumper):
    """YAML dumper that writes decimals as numbers."""


def _read_number(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> Decimal:
    try:
        return Decimal(node.value)
    except InvalidOperation:  # `.inf`, `1:30.5`
        return Decimal(loader.construct_yaml_float(node))


def _write_number(dumper: yaml.SafeDumper, value: Decimal) -> yaml.ScalarNode:
    if not value.is_finite():
        text = {'Infinity': '.inf', '-Infinity': '-.inf', 'NaN': '.nan'}[str(value)]
    elif not value:
        text = '0.0'
    elif -6 <= value.adjusted() < 17:
        text = f'{value.normalize():f}'
        text += '' if '.' in text else '.0'
    else:  # YAML 1.1 wants a point before the exponent
        digits, exponent = f'{value:e}'.split('e')
        text = f'{digits if "." in digits else digits + ".0"}e{exponent}'
    return dumper.represent_scalar('tag:yaml.org,2002:float', text)


_ExactLoader.add_constructor('tag:yaml.org,2002:float', _read_number)
_ExactDumper.add_representer(Decimal, _write_number)

"""Coils other than round ones: rectangles, paths, measured maps, cores, others' sources."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.constants import mu_0
from scipy.interpolate import make_interp_spline

from microbot_ros.common.errors import InputError
from microbot_ros.common.files import read_yaml
from microbot_ros.common.units import MU_0
from microbot_ros.magnetics import Allocator, CoilSet, CoilSettings, Loop, Polyline
from microbot_ros.magnetics.adapters import MagpylibSource
from microbot_ros.magnetics.field_map import COLUMNS, FieldMap, read_field_map
from microbot_ros.magnetics.saturation import Saturation

magpylib = pytest.importorskip('magpylib')

POINTS = np.random.default_rng(0).uniform(-2e-3, 2e-3, (30, 3))
LOOP = Loop(0.02, (0.03, 0, 0), (1, 0, 0), 400)


def windings(**changes: object) -> list[dict]:
    """The default rig's windings as people write them, the round wire of the second replaced."""
    content = CoilSettings().content('not none')['windings']
    round_wire = {'axis', 'radius_mm', 'turns'}
    content[1] = {key: value for key, value in content[1].items() if key not in round_wire}
    content[1] |= {key: value for key, value in changes.items() if value is not None}
    return content


def coils_of(**changes: object) -> CoilSet:
    return CoilSet(CoilSettings.from_content({'windings': windings(**changes)}))


def places(step: float = 1e-3, reach: float = 4e-3) -> tuple[np.ndarray, ...]:
    along = np.arange(-reach, reach + step / 2, step)
    return along, along, along


def sampled(source: Loop, grid: tuple[np.ndarray, ...]) -> np.ndarray:
    points = np.stack(np.meshgrid(*grid, indexing='ij'), axis=-1)
    return source.field_per_ampere(points.reshape(-1, 3)).reshape(points.shape)


def write_table(path: Path, change=lambda rows: rows, header=COLUMNS) -> Path:
    grid = places()
    points = np.stack(np.meshgrid(*grid, indexing='ij'), axis=-1).reshape(-1, 3)
    field = LOOP.field_per_ampere(points)
    rows = change(np.column_stack([np.round(1e3 * points, 6), 1e3 * field]).tolist())
    lines = [','.join(header), *(','.join(map(str, row)) for row in rows)]
    path.write_text('\n'.join(lines) + '\n')
    return path


@pytest.mark.parametrize(('axis', 'corner'), [
    ((1, 0, 0), (0, 10, 5)), ((0, -1, 0), (10, 0, 5)), ((0, 0, 2), (10, 5, 0))])
def test_width_lies_in_the_plane_of_the_workspace(axis, corner):
    # At the centre of a rectangle of the sides a and b: 2µ₀I √(a² + b²)/(πab), along the axis.
    a, b, position = 0.02, 0.01, 30 * np.array(axis)
    along = np.array(axis) / np.linalg.norm(axis)
    coils = coils_of(rectangle_mm=(20, 10), axis=axis, turns=100, position_mm=position.tolist())
    expected = 200 * MU_0 * np.hypot(a, b) / (np.pi * a * b) * along
    found = coils.field_per_ampere([1e-3 * position])[1, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)
    for signs in (1, -1):
        on_corner = 1e-3 * (position + signs * np.array(corner))
        assert np.isnan(coils.field_per_ampere([on_corner])[1]).all()


def test_a_rectangle_anywhere_is_the_path_of_its_corners_and_magpylib_agrees():
    axis = np.array([1.0, 2.0, 2.0]) / 3
    across = np.array([-2.0, 1.0, 0.0]) / np.sqrt(5)
    up = np.cross(axis, across)
    corners = np.array([-across - up, across - up, across + up, up - across]) * (6, 6, 6)
    rectangle = coils_of(rectangle_mm=(12, 12), axis=axis.tolist(), turns=50)
    path = coils_of(vertices_mm=corners.tolist(), turns=50)
    np.testing.assert_allclose(rectangle.field_per_ampere(POINTS), path.field_per_ampere(POINTS),
                               rtol=1e-12, atol=1e-18)
    vertices = 1e-3 * (np.vstack([corners, corners[:1]]) + np.array([30, 0, 0]))
    peer = magpylib.current.Polyline(vertices=vertices, current=50)
    np.testing.assert_allclose(path.field_per_ampere(POINTS)[1], peer.getB(POINTS), rtol=1e-9)
    assert rectangle.field_per_ampere([(0.03, 0, 0)])[1, 0] @ axis > 0


def test_a_path_that_ends_where_it_began_is_closed_once():
    square = [[0, 9, 9], [0, -9, 9], [0, -9, -9], [0, 9, -9]]
    closed = coils_of(vertices_mm=square, turns=9).field_per_ampere(POINTS)
    for said in ({'vertices_mm': [*square, square[0]]},
                 {'vertices_mm': [*square, square[0]], 'closed': False},
                 {'vertices_mm': square, 'closed': True}):
        np.testing.assert_array_equal(coils_of(turns=9, **said).field_per_ampere(POINTS), closed)


def test_margins_are_distances_to_the_wire():
    assert Loop(3, (0, 0, 4), (0, 0, 1)).margin(np.zeros(3)) == pytest.approx(5)
    assert Loop(3, (0, 0, 4), (0, 0, 1)).margin(np.array([3, 0, 2])) == pytest.approx(2)
    assert Loop(3, (5, 0, 0), (0, 0, 1)).margin(np.zeros(3)) == pytest.approx(2)
    bent = Polyline([[1, -1, 0], [1, 1, 0], [4, 1, 0], [4, -1, 0]])
    assert bent.margin(np.zeros(3)) == pytest.approx(1)
    assert bent.margin(np.array([2.5, 2, 0])) == pytest.approx(1)
    assert bent.margin(np.array([0, 3, 0])) == pytest.approx(np.sqrt(5))
    box = FieldMap(places(), sampled(LOOP, places()))
    assert box.margin(np.array([1e-3, 0, -3e-3])) == pytest.approx(1e-3)
    assert box.margin(np.array([5e-3, 0, 0])) == pytest.approx(-1e-3)


@pytest.mark.parametrize('counts', [(9, 3, 6), (2, 4, 2)])
def test_a_map_is_the_splines_along_its_axes_one_after_the_other(counts):
    """Of the third degree, or a lower one along axes of few places."""
    rng = np.random.default_rng(1)
    grid = tuple(np.cumsum(rng.uniform(0.5e-3, 2e-3, count)) - 4e-3 for count in counts)
    field = rng.normal(size=(*counts, 3))
    found = FieldMap(grid, field)
    low, high = (np.array([along[end] for along in grid]) for end in (0, -1))
    points = np.vstack([rng.uniform(low, high, (30, 3)), low, high])
    for orders in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)):
        expected = []
        for point in points:
            values = field
            for along, x, order in zip(grid, point, orders, strict=True):
                values = make_interp_spline(along, values, min(3, len(along) - 1))(x, nu=order)
            expected.append(values)
        actual = (found.gradient_per_ampere(points)[..., orders.index(1)] if any(orders)
                  else found.field_per_ampere(points))
        np.testing.assert_allclose(actual, expected, rtol=1e-9,
                                   atol=1e-12 * np.abs(expected).max())


def test_outside_a_map_there_is_no_field():
    found = FieldMap(places(), sampled(LOOP, places()))
    outside = [[4.1e-3, 0, 0], [0, 0, -5e-3], [np.nan, 0, 0], [0, np.inf, 0]]
    assert np.isnan(found.field_per_ampere(outside)).all()
    assert np.isnan(found.gradient_per_ampere(outside)).all()
    assert np.isfinite(found.field_per_ampere([[4e-3, 0, 0]])).all()


def test_table_and_arrays_are_the_same_map_in_any_order_beside_the_file_of_coils(tmp_path):
    rng = np.random.default_rng(0)
    (tmp_path / 'maps').mkdir()
    write_table(tmp_path / 'maps' / 'coil.csv',
                lambda rows: [rows[k] for k in rng.permutation(len(rows))])
    grid = places()
    np.savez(tmp_path / 'maps' / 'coil.npz', x_mm=1e3 * grid[0], y_mm=1e3 * grid[1],
             z_mm=1e3 * grid[2], field_mT_per_A=1e3 * sampled(LOOP, grid))
    for name in ('coil.csv', 'coil.npz'):
        content = windings(field_map=f'maps/{name}', position_mm=[0, 0, 0], gain=1.1, sign=-1)
        path = tmp_path / 'coils.yaml'
        path.write_text(yaml.safe_dump({'coils': {'windings': content}}))
        coils = CoilSet(read_yaml(path, CoilSettings))
        plain = CoilSet().field_per_ampere(POINTS)
        np.testing.assert_allclose(coils.field_per_ampere(POINTS)[1], -1.1 * plain[1], atol=1e-8)
        found = Allocator(coils).allocate((1e-3, 5e-4))
        np.testing.assert_allclose(found.field, (1e-3, 5e-4))
        # A map that lies elsewhere is moved with its coil.
        content[1]['position_mm'] = [0.5, -1, 1]
        path.write_text(yaml.safe_dump({'windings': content}))
        moved = CoilSet(read_yaml(path, CoilSettings)).field_per_ampere(
            POINTS + np.array([0.5e-3, -1e-3, 1e-3]))
        np.testing.assert_allclose(moved[1], coils.field_per_ampere(POINTS)[1], rtol=1e-9)
        # What is written elsewhere finds the map again.
        elsewhere = read_yaml(path, CoilSettings).content('not none')
        assert Path(elsewhere['windings'][1]['field_map']) == tmp_path / 'maps' / name


def without(index: int):
    return lambda rows: rows[:index] + rows[index + 1:]


def spoilt(value: str):
    return lambda rows: [*rows[:3], [*rows[3][:4], value, rows[3][5]], *rows[4:]]


@pytest.mark.parametrize(('change', 'header', 'complaint'), [
    (without(100), COLUMNS, r'full grid of 9 × 9 × 9 places; \(-3, -2, -3\) mm is missing'),
    (lambda rows: [*rows, rows[5]], COLUMNS, r'coil\.csv:731: expected every place once'),
    (spoilt('nan'), COLUMNS, r"coil\.csv:5: expected a number in 'by_mT_per_A', found 'nan'"),
    (spoilt('-inf'), COLUMNS, r"coil\.csv:5: expected a number in 'by_mT_per_A'"),
    (spoilt(''), COLUMNS, r"coil\.csv:5: expected a number in 'by_mT_per_A', found an empty cell"),
    (lambda rows: [row for row in rows if row[2] == 0], COLUMNS, 'two or more places along z'),
    (lambda rows: rows[:0], COLUMNS, r'coil\.csv:1: expected rows below'),
    (lambda rows: rows, (*COLUMNS[:5], 'bz'), r'coil\.csv:1: expected the header x_mm,y_mm,z_mm'),
    (lambda rows: [row for row in rows if abs(row[0]) <= 1], COLUMNS,
     "'coil_plus_x' has a map that ends 1 mm from the workspace centre; expected more than"),
])
def test_maps_with_holes_and_maps_that_do_not_cover_the_workspace(
        change, header, complaint, tmp_path):
    path = tmp_path / 'coils.yaml'
    write_table(tmp_path / 'coil.csv', change, header)
    path.write_text(yaml.safe_dump({'windings': windings(
        field_map='coil.csv', position_mm=[0, 0, 0])}))
    with pytest.raises(InputError, match=complaint) as error:
        read_yaml(path, CoilSettings)
    assert '\n' not in str(error.value)


@pytest.mark.parametrize(('arrays', 'complaint'), [
    ({'field_mT_per_A': np.zeros((3, 2, 2, 3))},
     r'an array of \(2, 2, 2, 3\); received one of \(3, 2'),
    ({'field_mT_per_A': np.full((2, 2, 2, 3), np.nan)}, 'expected a finite field'),
    ({'x_mm': np.array([1.0, -1.0])}, 'expected two or more places along x, ascending'),
    ({'z_mm': np.array([0.0, np.inf])}, 'expected two or more places along z'),
    ({'y_mm': np.zeros((2, 1))}, 'expected one dimension'),
    ({'y_mm': np.array(['a', 'b'])}, 'expected an NPZ file with x_mm'),
    ({'y_mm': None}, 'expected an NPZ file with x_mm'),
])
def test_arrays_that_are_no_map(arrays, complaint, tmp_path):
    line = np.array([-1.0, 1.0])
    fine = {'x_mm': line, 'y_mm': line, 'z_mm': line, 'field_mT_per_A': np.ones((2, 2, 2, 3))}
    content = {name: array for name, array in (fine | arrays).items() if array is not None}
    np.savez(tmp_path / 'map.npz', **content)
    with pytest.raises(InputError, match=complaint):
        read_field_map(tmp_path / 'map.npz')


def test_files_that_are_no_map(tmp_path):
    (tmp_path / 'map.npz').write_text('x')
    (tmp_path / 'torn.npz').write_bytes(b'PK\x03\x04' + bytes(60))
    (tmp_path / 'map.txt').write_text('x')
    for name, complaint in (('map.npz', 'expected an NPZ file'),
                            ('torn.npz', 'expected an NPZ file'), ('none.npz', 'expected an NPZ'),
                            ('none.csv', 'expected a readable CSV file'), ('map.txt', 'ending')):
        with pytest.raises(InputError, match=complaint):
            read_field_map(tmp_path / name)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.floats(0.01, 2), st.floats(0.01, 2)), min_size=1, max_size=8),
       st.floats(-1, 1))
def test_saturation_and_its_inverse_cancel_and_rise(steps, part):
    points = np.cumsum(steps, axis=0)
    curve = Saturation(points.tolist())
    np.testing.assert_allclose(curve.effective(points[:, 0]), points[:, 1], rtol=1e-9)
    np.testing.assert_allclose(curve.driven(-points[:, 1]), -points[:, 0], rtol=1e-12)
    driven = part * points[-1, 0]
    assert curve.driven(curve.effective(driven)) == pytest.approx(driven, rel=1e-7, abs=1e-12)
    line = np.linspace(-points[-1, 1], points[-1, 1], 101)
    assert (np.diff(curve.driven(line)) > 0).all()


def test_a_reading_just_beyond_a_saturation_goes_on_as_the_curve_ends():
    curve = Saturation([(1.0, 1.0), (2.0, 1.5)])
    assert curve.effective([2.001, -2.001]) == pytest.approx([1.5005, -1.5005], rel=1e-9)


def test_beyond_a_saturation_nothing_is_known():
    curve = Saturation([(1.0, 1.0), (2.0, 1.5)])
    for odd in (2.05, -2.05, np.nan, np.inf):
        assert np.isnan(curve.effective(odd))
        assert np.isnan(curve.driven(odd))


@pytest.mark.parametrize('points', [
    [], [(0.0, 0.0)], [(1, 1), (1, 2)], [(1, 1), (2, 1)], [(2, 1), (1, 2)], [(-1, 1)],
    [(1, np.nan)], [(np.inf, 1)]])
def test_saturations_that_do_not_rise(points):
    with pytest.raises(InputError, match='ascending from 0'):
        Saturation(points)


def test_a_core_that_saturates_is_driven_harder_up_to_its_limit_in_amperes():
    curve = [(0.5, 0.5), (1.0, 0.95), (1.5, 1.3), (2.0, 1.5)]
    content = CoilSettings().content('not none')['windings']
    content[1]['saturation'] = curve
    coils, plain = CoilSet(CoilSettings.from_content({'windings': content})), CoilSet()
    allocator = Allocator(coils)
    for wanted in ((1e-3, 0), (4e-3, 2e-3), (-5.5e-3, 0)):
        found = allocator.allocate(wanted)
        assert not found.saturated
        np.testing.assert_allclose(found.field, wanted, atol=1e-12)
        np.testing.assert_allclose(coils.field(found.currents, [[0, 0, 0]])[0, :2], wanted,
                                   atol=1e-12)
        assert found.power == pytest.approx(coils.power(found.currents))
        np.testing.assert_array_equal(allocator.currents(np.array([wanted]))[0], found.currents)
    # At 3.5 A worth along x the coil bears 2 A, true ones, and they are worth 1.5 A.
    most = allocator.allocate((1, 0))
    assert most.saturated
    np.testing.assert_allclose(most.currents, (0, 2, 0, -2), atol=1e-12)
    assert most.field[0] == pytest.approx(3.5 / 4 * Allocator(plain).allocate((1, 0)).field[0])
    gradient = coils.gradient(most.currents, POINTS)
    np.testing.assert_allclose(gradient, plain.gradient((0, 1.5, 0, -2), POINTS), atol=1e-12)
    np.testing.assert_array_equal(coils.effective([[1, 2, 1, 1]]), [[1, 1.5, 1, 1]])


@pytest.mark.parametrize(('change', 'complaint'), [
    ({'rectangle_mm': [5, 5], 'turns': 3}, 'expected radius_mm and axis, rectangle_mm and axis'),
    ({'rectangle_mm': [5, 0], 'axis': [1, 0, 0], 'turns': 3}, 'greater than 0'),
    ({'rectangle_mm': [5, float('nan')], 'axis': [1, 0, 0], 'turns': 3}, 'finite number'),
    ({'rectangle_mm': [5, 5], 'axis': [0, 0, 0], 'turns': 3}, 'expected a direction'),
    ({'rectangle_mm': [5, 5], 'axis': [1, 0, 0]}, 'expected turns of a wire'),
    ({'rectangle_mm': [5, 5], 'axis': [1, 0, 0], 'radius_mm': 9, 'turns': 3}, 'or one of'),
    ({'field_map': 'a.csv', 'turns': 3}, 'and none of a field_map'),
    ({'field_map': 'a.csv', 'axis': [1, 0, 0]}, 'vertices_mm, field_map and source alone'),
    ({'field_map': 'a.csv'}, r'a\.csv: expected a readable CSV file'),
    ({'source': 'none_such'}, "received 'none_such'"),
    ({'vertices_mm': [[0, 9, 0], [0, 0, 9], [0, 0, 0]], 'closed': False, 'turns': 1},
     'expected a closed path: its end must be its start'),
    ({'radius_mm': 9, 'axis': [1, 0, 0], 'turns': 9, 'closed': False}, 'closed path'),
    ({'radius_mm': 20, 'axis': [0, 0, 1], 'turns': 9, 'position_mm': [0, 20.5, 0]},
     r"'coil_plus_x' has its wire 0\.5 mm from the workspace centre; expected more than "
     r'workspace_mm, 1 mm'),
    ({'vertices_mm': [[-30, 9, 0], [-30, -9, 0], [-20, 0, 9]], 'turns': 1},
     r"'coil_plus_x' has its wire 0 mm from"),
    ({'radius_mm': 20, 'axis': [1, 0, 0], 'turns': 9, 'saturation': [[1, 1], [1.9, 1.5]]},
     'expected a saturation up to max_current_A'),
    ({'radius_mm': 20, 'axis': [1, 0, 0], 'turns': 9, 'saturation': [[1, 1], [2, 0.5]]},
     'ascending from 0'),
])
def test_coils_that_cannot_be_are_named_with_their_line(change, complaint, tmp_path):
    path = tmp_path / 'coils.yaml'
    path.write_text(yaml.safe_dump({'coils': {'windings': windings(**change)}}))
    with pytest.raises(InputError, match=complaint) as error:
        read_yaml(path, CoilSettings)
    assert '\n' not in str(error.value)
    assert f'{path}:' in str(error.value) or 'a.csv' in str(error.value)


def test_a_source_of_magpylibs_is_a_coil_with_a_gradient_by_differences():
    peer = magpylib.current.Circle(diameter=0.04, current=400, position=(0, 0, 0.03))
    own = Loop(0.02, (0, 0, 0.03), (0, 0, 1), 400)
    adapted = MagpylibSource(peer)
    ours = MU_0 / mu_0  # magpylib takes that of the SciPy that is installed
    np.testing.assert_allclose(ours * adapted.field_per_ampere(POINTS),
                               own.field_per_ampere(POINTS), rtol=1e-12, atol=1e-18)
    true = own.gradient_per_ampere(POINTS)
    np.testing.assert_allclose(adapted.gradient_per_ampere(POINTS), true,
                               atol=1e-9 * np.abs(true).max())
    pair = magpylib.Collection(peer, peer.copy(position=(0, 0, -0.03)))
    both = own.field_per_ampere([[0, 0, 0]]) + Loop(
        0.02, (0, 0, -0.03), (0, 0, 1), 400).field_per_ampere([[0, 0, 0]])
    found = MagpylibSource(pair).field_per_ampere([[0, 0, 0]])
    np.testing.assert_allclose(ours * found, both, atol=1e-15)
    for step in (0, -1e-4, np.nan, np.inf):
        with pytest.raises(InputError, match='step: expected'):
            MagpylibSource(peer, step)


def test_coils_of_packages_are_found_by_name(tmp_path, monkeypatch):
    (tmp_path / 'lab_coils.py').write_text(
        'import magpylib\n'
        'plus_x = magpylib.current.Circle(diameter=0.04, current=400).rotate_from_angax(90, "y")\n'
        'from microbot_ros.magnetics import Loop\n'
        'ready = Loop(0.02, (0, 0, 0), (1, 0, 0), 400)\n')
    info = tmp_path / 'lab_coils-1.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: lab_coils\nVersion: 1\n')
    (info / 'entry_points.txt').write_text(
        '[microbot_ros.coils]\nplus_x = lab_coils:plus_x\nready = lab_coils:ready\n'
        'broken = lab_coils:none\n')
    monkeypatch.syspath_prepend(tmp_path)
    expected = CoilSet().field_per_ampere(POINTS)
    for name in ('plus_x', 'ready'):
        found = coils_of(source=name).field_per_ampere(POINTS)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)
    with pytest.raises(ValueError, match="'broken' does not load; AttributeError"):
        coils_of(source='broken')


def test_without_magpylib_one_line_says_what_is_missing():
    code = ('import sys; sys.modules["magpylib"] = None\n'
            'from microbot_ros.magnetics.adapters import MagpylibSource\n'
            'try:\n    MagpylibSource(None)\nexcept ValueError as error:\n    print(error)')
    said = subprocess.run([sys.executable, '-c', code], check=True, capture_output=True, text=True)
    assert said.stdout == ('magpylib: expected it to be installed for a coil that is one of its '
                           'sources; pip install magpylib\n')

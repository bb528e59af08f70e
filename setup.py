from glob import glob

from setuptools import find_packages, setup

package_name = 'microbot_ros'

# What ROS installations bring by themselves; elsewhere `pip install microbot_ros[ros]` does.
ros_from_pypi = ['ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces']

# What a feature needs beyond the core; `microbot_ros.common.extras` names them when missing.
features = {
    'analysis': ['jinja2>=3.1', 'matplotlib>=3.8', 'openpyxl>=3.1', 'rich>=13.0'],
    'cockpit': ['starlette>=0.40', 'uvicorn>=0.35', 'websockets>=13'],
    'mcap': ['lz4>=4.3', 'mcap>=1.1', 'rosbags>=0.10', 'zstandard>=0.22'],
    'modbus': ['pymodbus>=3.10'],
    'predictive': ['osqp>=1.0'],
    'video': ['av>=12.0'],
}
# Features that few users need: many cores, cameras of other makers, training of controllers.
special = {
    # bokeh is for Dask's dashboard.
    'dask': ['bokeh>=3.1', 'dask>=2024.8', 'distributed>=2024.8', 'pyarrow>=14'],
    'cameras': ['pymmcore>=11.9', 'pypylon>=4.2'],
    'gym': ['gymnasium'],
    'onnx': ['onnx', 'onnxruntime'],
}
everything = [library for libraries in features.values() for library in libraries]
beyond = [library for libraries in special.values() for library in libraries]

# What every test needs; by the name of this extra `colcon test` knows that they are pytest's.
tests = ['hypothesis', 'psutil', 'pytest', 'pytest-timeout']

# What `make docs` needs.
documents = ['furo', 'myst-parser', 'sphinx']

development = [
    *everything, *beyond, *documents, *tests, 'axe-playwright-python', 'catkin_pkg',
    'colcon-common-extensions', 'coverage', 'duckdb', 'fastjsonschema', 'import-linter',
    'magpylib', 'mm-test-adapters', 'mypy', 'numpydoc', 'playwright>=1.48', 'polars',
    'pyoperon>=0.6', 'pysindy', 'pytest-cov', 'pytest-xdist', 'rosdep', 'ruff',
    'StochasticForceInference',
    'trackpy', 'types-PyYAML', 'types-pyserial', 'wheel',
]

nodes = [
    'camera', 'cockpit', 'coil_driver', 'controller', 'model', 'player', 'recorder', 'tracker',
    'virtual_rig',
]

amplifiers = {
    'serial_transfer': 'SerialTransferAmplifier', 'scpi': 'ScpiAmplifier',
    'sabertooth': 'SabertoothAmplifier', 'roboclaw': 'RoboclawAmplifier',
    'modbus': 'ModbusAmplifier', 'roboteq': 'RoboteqAmplifier',
}

setup(
    name=package_name,
    version='0.1.0',
    packages=find_packages(include=[package_name, f'{package_name}.*']),
    package_data={package_name: [
        '**/*.html', '**/*.css', '**/*.js', '**/*.LICENSE', '**/*.xml', '**/*.yaml', 'py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
        (f'share/{package_name}/launch', glob('launch/*_launch.py')),
        (f'share/{package_name}/config', glob('config/*.*')),
    ],
    python_requires='>=3.11',
    # The core. Each has a rosdep key of an Ubuntu package. The bounds are the oldest versions that
    # `make lowest` runs the tests of the core with.
    install_requires=[
        'click>=8.1', 'numba>=0.59', 'numpy>=1.26', 'opencv-python-headless>=4.6',
        'pyserial>=3.5', 'pyyaml>=6.0.1', 'scipy>=1.11',
    ],
    extras_require={
        'ros': ros_from_pypi, **features, **special, 'all': everything,
        'test': tests, 'docs': documents, 'dev': development},
    zip_safe=False,
    maintainer='microbot_ros maintainers',
    maintainer_email='maintainers@microbot-ros.example',
    description='Closed-loop coil control of magnetic Janus microrobots under a microscope.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'microbot = microbot_ros.cli:script',
            *(f'{node}_node = microbot_ros.nodes.process:script' for node in nodes),
        ],
        'microbot_ros.controllers': [
            'ensemble = microbot_ros.control.plugins.ensemble:Ensemble',
            'experiment = microbot_ros.control.plugins.experiment:Experiment',
            'formation = microbot_ros.control.plugins.formation:Formation',
            'hold = microbot_ros.control.plugins.hold:Hold',
            'manual = microbot_ros.control.plugins.manual:Manual',
            'open_loop = microbot_ros.control.plugins.open_loop:OpenLoop',
            'path_following = microbot_ros.control.plugins.path_following:PathFollowing',
            'policy = microbot_ros.control.plugins.policy:Policy',
            'predictive = microbot_ros.control.plugins.predictive:Predictive',
            'pushing = microbot_ros.control.plugins.pushing:Pushing',
            'roller = microbot_ros.control.plugins.roller:Roller',
            'swarm = microbot_ros.control.plugins.swarm:Swarm',
            'teleop = microbot_ros.control.plugins.teleop:Teleop',
            'waypoint = microbot_ros.control.plugins.waypoint:Waypoint',
        ],
        'microbot_ros.amplifiers': [
            f'{protocol} = microbot_ros.drive.amplifiers.{protocol}.driver:{driver}'
            for protocol, driver in amplifiers.items()
        ],
        'microbot_ros.cameras': [
            'aravis = microbot_ros.cameras.aravis:AravisCamera',
            'file = microbot_ros.cameras.file:FileCamera',
            'micromanager = microbot_ros.cameras.micromanager:MicroManagerCamera',
            'pylon = microbot_ros.cameras.pylon:PylonCamera',
            'v4l2 = microbot_ros.cameras.v4l2:V4l2Camera',
        ],
    },
)

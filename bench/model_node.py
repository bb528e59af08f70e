"""What the model node costs, ROS and all: 200 particles at 100 Hz, the field read back at 50."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
import yaml
from sensor_msgs.msg import MagneticField, PointCloud2

from bench.figure import Figure
from microbot_ros.loop.points import PARTICLE
from microbot_ros.nodes.base import messages
from microbot_ros.nodes.client.graph import Graph
from microbot_ros.nodes.client.graph_client import GraphClient

RATE_HZ, PARTICLES, WARM_FRAMES, FRAMES = 100, 200, 1000, 3000


def figures() -> list[Figure]:
    """Share of a core that the node's process takes once it is warm."""
    with tempfile.TemporaryDirectory() as folder:
        parameters = Path(folder) / 'parameters.yaml'
        parameters.write_text(yaml.safe_dump({'model': {'ros__parameters': {'radius_um': 2.3}}}))
        with Graph(lambda *_: None) as graph, GraphClient('load') as client:
            graph.start_node('model', parameters)
            graph.wait_ready(120.0)
            share = 100 * _share(client, psutil.Process(graph.process_id('model')))
    return [Figure(4, 'model node, 200 particles at 100 Hz', share, '% of a core', '≤ 20', '',
                   share <= 20)]


def _share(client: GraphClient, process: psutil.Process) -> float:
    particles = client.node.create_publisher(PointCloud2, 'particles', 10)
    fields = client.node.create_publisher(MagneticField, 'field/applied', 10)
    while not particles.get_subscription_count():
        client.spin(0.05)
    rng = np.random.default_rng(0)
    points = np.zeros(PARTICLES, PARTICLE)
    points['id'], points['sigma'] = np.arange(PARTICLES), 5e-8
    place = rng.uniform(-1e-4, 1e-4, PARTICLES) + 1j * rng.uniform(-1e-4, 1e-4, PARTICLES)
    swim = 4e-6 / RATE_HZ * np.exp(1j * rng.uniform(-np.pi, np.pi, PARTICLES))
    begin, spent, since = time.time(), 0.0, 0.0
    for frame in range(FRAMES):
        if frame == WARM_FRAMES:
            spent, since = sum(process.cpu_times()[:2]), time.time()
        t = begin + frame / RATE_HZ
        time.sleep(max(0.0, t - time.time()))
        angle = 2.1 * (frame // 150)
        if frame % 2 == 0:
            field = 5e-3 * np.array([np.cos(angle), np.sin(angle)])
            fields.publish(messages.magnetic_field(field, messages.to_stamp(t)))
        noise = rng.normal(0, np.sqrt(2 * 0.05e-12 / RATE_HZ), (2, PARTICLES))
        place = place + swim * np.exp(1j * angle) + noise[0] + 1j * noise[1]
        points['x'] = place.real + rng.normal(0, 5e-8, PARTICLES)
        points['y'] = place.imag + rng.normal(0, 5e-8, PARTICLES)
        particles.publish(messages.cloud(points, messages.to_stamp(t)))
    return (sum(process.cpu_times()[:2]) - spent) / (time.time() - since)

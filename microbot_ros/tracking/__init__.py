"""From frames to particles with lasting identities, and from pixels to metres.

Examples
--------
The middle of the image is the origin of the workspace, y points up:

>>> import numpy as np
>>> from microbot_ros.tracking import ImageToWorkspace
>>> camera = ImageToWorkspace(pixel_size=0.5e-6, width=641, height=481)
>>> camera.pixels(np.array([0.0, 10e-6])).tolist()
[320.0, 220.0]
"""

from microbot_ros.tracking.camera import ImageToWorkspace
from microbot_ros.tracking.drive import Drive
from microbot_ros.tracking.refine.appearance import Appearance
from microbot_ros.tracking.settings import TrackerSettings
from microbot_ros.tracking.teach.learn import learn
from microbot_ros.tracking.tracker import FrameError, Poses, Tracker
from microbot_ros.tracking.warm import warm_up

__all__ = [
    'Appearance', 'Drive', 'FrameError', 'ImageToWorkspace', 'Poses', 'Tracker', 'TrackerSettings',
    'learn', 'warm_up',
]

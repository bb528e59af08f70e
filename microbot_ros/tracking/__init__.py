"""From frames to particles with lasting identities, and from pixels to metres."""

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

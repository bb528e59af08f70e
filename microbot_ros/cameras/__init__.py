"""Cameras and files as sources of frames, each with its time of exposure and its number.

Examples
--------
A folder of images is a camera, too:

>>> import tempfile, cv2, numpy as np
>>> from microbot_ros.cameras.source import open_source
>>> with tempfile.TemporaryDirectory() as folder:
...     for k in range(3):
...         _ = cv2.imwrite(f'{folder}/{k}.png', np.full((48, 64), 10 * k, np.uint8))
...     [(frame.index, frame.image.shape) for frame in open_source(folder, print).frames()]
[(0, (48, 64)), (1, (48, 64)), (2, (48, 64))]
"""

"""Entry point of `python -m microbot_ros.cli`, for machines without scripts on the path."""

from microbot_ros.cli import script

script()

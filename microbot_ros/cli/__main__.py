"""`python -m microbot_ros.cli`, for machines where scripts are not on the path."""

from microbot_ros.cli import script

script()

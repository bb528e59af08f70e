"""Entry point of `python -m microbot_ros.nodes NODE`."""

from microbot_ros.nodes.process import main

main()

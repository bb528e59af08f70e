# microbot_ros on ROS 2 Jazzy. Untested by `make test`, which has no Docker.
#   docker build -t microbot_ros . && docker run --rm microbot_ros microbot demo --out /tmp/demo
FROM ros:jazzy-ros-base

RUN apt-get update && apt-get install -y --no-install-recommends \
        python3-pip python3-venv python3-colcon-common-extensions \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /workspace
COPY . src/microbot_ros

# What Ubuntu packages is too old for some of it: see docs/how-to/with_ros.md.
RUN python3 -m venv --system-site-packages .venv && touch .venv/COLCON_IGNORE \
    && .venv/bin/pip install --no-cache-dir "./src/microbot_ros[all]" \
    && . /opt/ros/jazzy/setup.sh && .venv/bin/python -m colcon build

ENV PATH="/workspace/.venv/bin:$PATH"
# `docker stop` sends SIGTERM, which every node takes as the order to zero the coils and end; what is
# left after 10 s is killed, so give a recorder more time: `docker stop --time 30`.
STOPSIGNAL SIGTERM
ENTRYPOINT ["/workspace/src/microbot_ros/docker_entrypoint.sh"]
CMD ["microbot", "--help"]

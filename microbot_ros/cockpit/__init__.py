"""The operator's page and its server: pictures, state and verbs over one socket, without ROS."""

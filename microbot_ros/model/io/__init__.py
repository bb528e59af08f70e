"""Models, effects and learned terms as YAML."""

"""The error of the settings."""


class ConfigError(Exception):
    """A setting is missing, unknown or impossible; names the file and the key."""

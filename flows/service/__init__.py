"""What `solmap up` runs unattended: schedules, the inbox, requests for runs, and their processes.

Inputs are the settings, files in the inbox and requests from the map; outputs are runs of flows,
submitted to Prefect's server. Imported by `flows.cli` only. Modules that import Prefect are
imported after the engine's environment is set.
"""

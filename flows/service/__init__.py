"""What `solmap up` runs unattended: schedules, the inbox, requests for runs, and their processes.

Enter the settings, files in the inbox and requests from the map; leave runs of flows, submitted to
Prefect's server. Imported by `flows.cli` only. Modules that import Prefect are imported after the
engine's environment is set.
"""

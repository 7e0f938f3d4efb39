"""What `solmap up` runs unattended: schedules, the inbox, requests for runs, and their processes.

Enter the settings, files in the inbox and what people ask for on the map; leave runs of flows,
asked of Prefect's server. Imported by `flows.cli` only. Modules that import Prefect are imported
after the engine's environment is set.
"""

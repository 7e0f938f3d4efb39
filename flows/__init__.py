"""The order of the tasks, and the command line that runs them."""

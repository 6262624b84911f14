"""What each command of the rig does; one module per command, imported when it runs."""

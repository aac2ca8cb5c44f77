"""The `inspector` command and the browser application on viser."""

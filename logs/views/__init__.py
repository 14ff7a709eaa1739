"""Logs looked at: replay in Rerun, figures, the report page, video."""

"""What a recording says about HashMatch, read back: tables, maps of the pyramid, single templates, reports of windows."""

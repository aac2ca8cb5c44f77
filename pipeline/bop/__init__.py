"""The BOP format and the BOP benchmark: data on disk, pose errors, scores. Millimetres stay in here."""

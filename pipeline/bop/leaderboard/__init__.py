"""The leaderboard: results files that were handed in, their evaluations, and the table of both."""

"""The leaderboard in the browser: scores of all methods, each of which opens the targets behind it."""

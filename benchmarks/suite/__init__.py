"""The suite: every protocol for every preset and its peers in one run, against a committed baseline."""

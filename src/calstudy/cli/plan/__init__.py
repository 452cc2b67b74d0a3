"""Commands on the experimental plan and its studies: shown, run, run again, looked at."""

"""The hall's corridor of files and directories: written whole, and removed only where they are ours."""

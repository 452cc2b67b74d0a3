"""What a study shows: short modules, each drawing or tabulating one thing from a study's tables."""

"""Results for people: the terminal, pages, pictures and files."""

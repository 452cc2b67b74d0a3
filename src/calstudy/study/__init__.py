"""Study directories, and the campaigns that fill them."""

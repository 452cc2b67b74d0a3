"""What more material tests buy: the rows of a plan with the number of tests as a factor."""
